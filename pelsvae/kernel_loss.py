"""How unlikely a kernel is after what was simulated, with derivatives in closed form.

Derivatives by reverse differentiation would keep every intermediate matrix of n x n and pass over each again:
two thirds of the time at all sizes. In closed form a scale of bumps B costs one pass and one product with
the n x f warped features, for with S = dL/dk symmetric and E = S B element by element

    sum_ij E_ij (w_i - w_j)² = 2 (sum_i w_i² sum_j E_ij - sum_i w_i (E w)_i)

for every feature. What S is, is Eq. 5.9 of Rasmussen and Williams 2006, Gaussian Processes for Machine
Learning.
"""

import math

import numpy as np
import torch
from torch import Tensor

from pelsvae.kernel import JITTER, N_INDEPENDENT, Kernel, Prior
from pelsvae.standardize import Array


def kernel_loss(
    kernel: Kernel, hyper: Array, x: Tensor, codes: Tensor, prior: Prior, n_independent: float = N_INDEPENDENT
) -> tuple[float, Array]:
    """Return minus the logarithm of the posterior density and its gradient, infinite where none exists.

    Args:
        kernel: Form of the kernel.
        hyper: Its hyperparameters. Shape (h,).
        x: Features of the rows. Shape (n, f). [1]
        codes: Values of the rows, whose squares sum up to n. Shape (n, z). [1]
        prior: Of the hyperparameters.
        n_independent: As how many independent values the codes of a row count.

    Returns:
        The value, and the derivatives by the hyperparameters. Shape (h,).
    """
    n, half = len(x), 0.5 * n_independent
    with torch.no_grad():
        at = torch.from_numpy(hyper).to(x.device)
        warped = kernel.warped(at, x)
        bumps = (kernel.near(at, warped) @ kernel.far(at, warped)).exp2_()  # (s, n, n)
        product = kernel.products(at, warped, warped)
        matrix = kernel.on_trunk(at, bumps.sum(dim=0), product)
        # Last, as the noise has a share of the trace without it.
        matrix.diagonal().add_(kernel.noise(at, matrix))
        # A code, not an exception: without a factor the value is infinite, and the search goes on.
        factor, failed = torch.linalg.cholesky_ex(matrix)
        if failed:
            return math.inf, np.zeros(len(hyper))
        slopes = torch.cholesky_inverse(factor)
        # All codes share the kernel, so one factorization serves them all.
        solved = slopes @ codes
        misfit = (codes * solved).sum()
        log_factor = factor.diagonal().log().sum()
        # The amplitude's most probable value, misfit / n, is put in: hence the logarithm of the misfit.
        value = n_independent * (log_factor + 0.5 * n * torch.log(misfit / n))
        # K^-1 - alpha alpha' over the amplitude, in place: the inverse is needed no more.
        slopes.addmm_(solved * (-half * n / misfit), solved.T, beta=half)
        gradient = _pulled_back(kernel, at, (x, warped), bumps, product, slopes)
    mean, deviation = prior
    step = (hyper - mean) / deviation
    return float(value) + 0.5 * float(np.square(step).sum()), gradient.cpu().numpy() + step / deviation


def _pulled_back(
    kernel: Kernel,
    hyper: Tensor,
    features: tuple[Tensor, Tensor],
    bumps: Tensor,
    product: Tensor,
    slopes: Tensor,
) -> Tensor:
    """Return the derivatives by the hyperparameters of what has these slopes by covariances.

    Args:
        kernel: Form of the kernel.
        hyper: Hyperparameters. Shape (h,).
        features: Plain and warped. Shapes (n, f). [1]
        bumps: Of every scale; overwritten. Shape (s, n, n).
        product: Of warped features, divided by the first scale's lengths. Shape (n, n).
        slopes: Symmetric; overwritten. Shape (n, n).

    Returns:
        Shape (h,).
    """
    x, warped = features
    inverse = kernel.lengths(hyper).square().reciprocal()  # (s, f)
    diagonal = slopes.diagonal()
    # Before the diagonal changes, which is a view of the slopes.
    trace = diagonal.sum()
    noise = 2.0 * (2.0 * hyper[-1]).exp() * trace
    diagonal.add_(JITTER * trace)  # the noise has a share of the covariances' trace

    # In place: s more matrices of n x n would be the largest allocation of a step.
    each = bumps.mul_(slopes)  # (s, n, n)
    sums = each.sum(dim=2)  # (s, n)
    # sum_j E_ij (w_i - w_j), without the n x n x f differences.
    apart = sums[..., None] * warped - each @ warped  # (s, n, f)
    by_length = 2.0 * inverse * (warped * apart).sum(dim=1)  # (s, f)
    by_warped = -2.0 * (inverse[:, None] * apart).sum(dim=0)  # (n, f)
    by_weight = sums[1:].sum(dim=1)

    by_square, total = [], torch.zeros_like(slopes)
    for power, square in enumerate(kernel.polynomial(hyper), start=1):
        # Before the next product: the derivative of <w, w'>^power has the power before.
        total.addcmul_(slopes, power * square)
        slopes.mul_(product)
        by_square.append(2.0 * square * slopes.sum())
    turned = inverse[0] * (total @ warped)
    by_length[0] -= 2.0 * (warped * turned).sum(dim=0)
    by_warped += 2.0 * turned

    by_warp = (by_warped * kernel.warped_slope(hyper, x, warped)).sum(dim=0)
    # In the order of `Kernel.prior`.
    return torch.cat([by_length.flatten(), by_weight, by_warp, torch.stack([*by_square, noise])])
