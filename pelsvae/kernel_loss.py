"""How unlikely kernels are after what was simulated, with derivatives in closed form.

Derivatives by reverse differentiation would keep every intermediate matrix of n x n and pass over each again:
two thirds of the time at all sizes. In closed form a scale of bumps B costs one pass and one product with
the n x f warped features, for with S = dL/dk symmetric and E = S B element by element

    sum_ij E_ij (w_i - w_j)² = 2 (sum_i w_i² sum_j E_ij - sum_i w_i (E w)_i)

for every feature. What S is, is Eq. 5.9 of Rasmussen and Williams 2006, Gaussian Processes for Machine
Learning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from torch import Tensor

from pelsvae.kernel import JITTER, N_INDEPENDENT, Kernel, Prior
from pelsvae.standardize import Array


def kernel_losses(
    kernel: Kernel, hyper: Array, x: Tensor, codes: Tensor, prior: Prior, n_independent: float = N_INDEPENDENT
) -> tuple[Array, Array]:
    """Return minus the logarithms of posterior density and their gradients, infinite where none exists.

    Args:
        kernel: Form of all kernels; none changes what is said of another, but for rounding.
        hyper: Hyperparameters of b kernels. Shape (b, h).
        x: Features of the rows. Shape (n, f). [1]
        codes: Values of each kernel, whose squares sum up to n. Shape (b, n, z). [1]
        prior: Of the hyperparameters, for each kernel or for all.
        n_independent: As how many independent values the codes of a row count.

    Returns:
        Values, shape (b,), and derivatives, shape (b, h).
    """
    n = len(x)
    with torch.no_grad():
        covariances = _Covariances.of(kernel, torch.from_numpy(hyper).to(x.device), x)
        factor, failed = torch.linalg.cholesky_ex(covariances.matrix)
        is_none = failed != 0
        if is_none.any():
            factor[is_none] = torch.eye(n, dtype=x.dtype, device=x.device)
        slopes = torch.cholesky_inverse(factor)
        solved = slopes @ codes
        misfit = (codes * solved).sum(dim=(1, 2))
        log_factor = factor.diagonal(dim1=1, dim2=2).log().sum(dim=1)
        value = n_independent * (log_factor + 0.5 * n * torch.log(misfit / n))
        half = 0.5 * n_independent
        slopes.baddbmm_(solved * (-half * n / misfit)[:, None, None], solved.mT, beta=half)
        gradient = covariances.pulled_back(slopes)
    mean, deviation = prior
    step = (hyper - mean) / deviation
    values = value.cpu().numpy() + 0.5 * np.square(step).sum(axis=1)
    gradients = gradient.cpu().numpy() + step / deviation
    none = is_none.cpu().numpy()
    values[none], gradients[none] = math.inf, 0.0
    return values, gradients


@dataclass(eq=False)
class _Covariances:
    """The covariances of rows by b kernels, noise included, and what their derivatives need.

    Attributes:
        kernel: Their form.
        hyper: Hyperparameters. Shape (b, h).
        x: Features. Shape (n, f). [1]
        warped: The features warped. Shape (b, n, f). [1]
        bumps: Of every scale. Shape (b, s, n, n); `pulled_back` overwrites them.
        product: Of warped features, divided by the first scale's lengths. Shape (b, n, n).
        matrix: The covariances. Shape (b, n, n).
    """

    kernel: Kernel
    hyper: Tensor
    x: Tensor
    warped: Tensor
    bumps: Tensor
    product: Tensor
    matrix: Tensor

    @classmethod
    def of(cls, kernel: Kernel, hyper: Tensor, x: Tensor) -> Self:
        warped = kernel.warped(hyper, x)
        bumps = (kernel.near(hyper, warped)[:, None] @ kernel.far(hyper, warped)).exp2_()
        product = kernel.products(hyper, warped, warped)
        matrix = kernel.on_trunk(hyper, bumps.sum(dim=1), product)
        matrix.diagonal(dim1=1, dim2=2).add_(kernel.noise(hyper, matrix)[:, None])
        return cls(kernel, hyper, x, warped, bumps, product, matrix)

    def pulled_back(self, slopes: Tensor) -> Tensor:
        """Return the derivatives by the hyperparameters, (b, h), of what has slopes (b, n, n) by covariances.

        The slopes are symmetric; bumps and slopes are overwritten.
        """
        kernel, warped = self.kernel, self.warped
        inverse = kernel.lengths(self.hyper).square().reciprocal()  # (b, s, f)
        diagonal = slopes.diagonal(dim1=1, dim2=2)
        trace = diagonal.sum(dim=1)
        noise = 2.0 * (2.0 * self.hyper[:, -1]).exp() * trace
        diagonal.add_((JITTER * trace)[:, None])  # the noise has a share of the covariances' trace

        each = self.bumps.mul_(slopes[:, None])  # (b, s, n, n)
        sums = each.sum(dim=3)  # (b, s, n)
        apart = sums[..., None] * warped[:, None] - each @ warped[:, None]  # (b, s, n, f)
        by_length = 2.0 * inverse * (warped[:, None] * apart).sum(dim=2)  # (b, s, f)
        by_warped = -2.0 * (inverse[:, :, None] * apart).sum(dim=1)  # (b, n, f)
        by_weight = sums[:, 1:].sum(dim=2)

        by_square, total = [], torch.zeros_like(slopes)
        for power, square in enumerate(kernel.polynomial(self.hyper).unbind(dim=1), start=1):
            total.addcmul_(slopes, power * square[:, None, None])
            slopes.mul_(self.product)
            by_square.append(2.0 * square * slopes.sum(dim=(1, 2)))
        turned = inverse[:, :1] * (total @ warped)
        by_length[:, 0] -= 2.0 * (warped * turned).sum(dim=1)
        by_warped += 2.0 * turned

        by_warp = (by_warped * kernel.warped_slope(self.hyper, self.x, warped)).sum(dim=1)
        by_others = torch.stack([*by_square, noise], dim=1)
        return torch.cat([by_length.flatten(start_dim=1), by_weight, by_warp, by_others], dim=1)
