"""The covariance of a Gaussian process over features of theta, and how probable it makes what was simulated.

Principal coordinates of the trajectories, all or some of them, share one kernel,

    k = c² + a² <w, w'>_1 + q² <w, w'>_1² + sum over s of b_s² exp(-|w - w'|_s² / 2),

of warped features w = (exp(v x) - 1) / v, where <.,.>_s and |.|_s divide every feature by a length of its own
in scale s, and b_1 = 1. The warp v of a logarithm makes it a power; it says in which power of a parameter
the trajectories are even. A scale whose lengths are large for some features is blind to these: a sum of
scales is a sum of functions of few parameters each, which few simulations determine. Far from the data the
polynomial goes on; bumps alone would fall back to the mean. Lengths, weights and noise are the most probable
ones under normal priors of their logarithms; the amplitude is profiled out (Rasmussen and Williams 2006,
Gaussian Processes for Machine Learning, Eq. 5.8).
"""

import functools
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from pelsvae.standardize import Array

CONSTANT = 10.0  # variance c², relative to the first scale's: the mean is as good as unknown
# Of the matrix's trace, on its diagonal: what rounding may cost before a factor fails to exist.
JITTER = 1e-12

# Normal priors of the logarithms, (mean, deviation). A feature's deviation is 1; a uniform one is 3.5 wide.
# Narrower priors of the lengths brought no gain (docs/notes/surrogates.md).
_LENGTH = (math.log(5.0), 1.0)
_LONGER = math.log(3.0)  # from one scale to the next, after _SECOND
_SECOND = math.log(2.7)
_WEIGHT = 2.0  # deviation of log b_s²; its mean is s - 1
_SLOPE = (0.0, 1.0)
_BEND = (-1.0, 1.0)
# Warped features: 0.157 instead of 0.172 K on the office at n = 256.
_WARP = (0.0, 0.15)  # of v itself
_NOISE = (math.log(1e-3), 0.5)
_LEAST_WARP = 1e-4  # below, expm1(v x) / v is x to all digits that matter, and 0 / 0 at 0
_REACH = 5.0  # deviations to either side within which the search stays
_LOG2_E = math.log2(math.e)  # powers of two are three times as fast as those of e

# Values of one trajectory, and coordinates of many, are far from independent: so many count as independent.
# 6 or 24 brought no gain (docs/notes/surrogates.md).
N_INDEPENDENT = 12.0

Prior = tuple[Array, Array]
"""Mean and deviation of the hyperparameters. Each of shape (h,)."""


@dataclass(frozen=True)
class Kernel:
    """The form of the kernel; its hyperparameters are a flat vector, h of them: logarithms, and warps.

    Attributes:
        n_features: f.
        n_scales: Sums of bumps, each with f lengths.
        degree: Of the polynomial, 1 or 2.
    """

    n_features: int
    n_scales: int
    degree: int

    @cached_property
    def prior(self) -> Prior:
        """What is believed of the hyperparameters without data."""
        rows: list[tuple[float, float]] = []
        for scale in range(self.n_scales):
            longer = _SECOND + (scale - 1) * _LONGER if scale else 0.0
            rows += [(_LENGTH[0] + longer, _LENGTH[1])] * self.n_features
        rows += [(float(scale), _WEIGHT) for scale in range(1, self.n_scales)]
        rows += [_WARP] * self.n_features + [*(_SLOPE, _BEND)[: self.degree], _NOISE]
        mean, deviation = np.array(rows).T
        return mean, deviation

    @property
    def bounds(self) -> list[tuple[float, float]]:
        """Where the search for the most probable hyperparameters stays. h pairs."""
        mean, deviation = self.prior
        return list(zip(mean - _REACH * deviation, mean + _REACH * deviation, strict=True))

    def lengths(self, hyper: Tensor) -> Tensor:
        """Return every scale's lengths: (h,) -> (s, f)."""
        return hyper[: self.n_scales * self.n_features].reshape(self.n_scales, self.n_features).exp()

    def stretched(self, hyper: Array, factor: float) -> Array:
        """Return hyperparameters with every length multiplied: (h,) -> (h,)."""
        longer = hyper.copy()
        longer[: self.n_scales * self.n_features] += math.log(factor)
        return longer

    def weights(self, hyper: Tensor) -> Tensor:
        """Return b_s²: (h,) -> (s,)."""
        start = self.n_scales * self.n_features
        # The first weight is 1: the amplitude is profiled out, so one scale has to be the unit.
        return torch.cat([torch.zeros_like(hyper[:1]), hyper[start : start + self.n_scales - 1]]).exp()

    def polynomial(self, hyper: Tensor) -> Tensor:
        """Return the squares of slope and bend: (h,) -> (degree,)."""
        return (2.0 * hyper[-1 - self.degree : -1]).exp()

    def warped(self, hyper: Tensor, x: Tensor) -> Tensor:
        """Return warped features: (h,), (n, f) -> (n, f)."""
        warp = self._warp(hyper)
        # Box-Cox transformation of a parameter whose logarithm is x; expm1 keeps the digits of small warps.
        return torch.expm1(warp * x) / warp

    def warped_slope(self, hyper: Tensor, x: Tensor, warped: Tensor) -> Tensor:
        """Return the derivatives of warped features by their warps, 0 where a warp is next to none."""
        warp = self._warp(hyper)
        # exp(v x) is 1 + v w, so no second exponential is needed.
        slope = (x * (1.0 + warp * warped) - warped) / warp
        # There the warp is held constant, and the quotient would be rounding over next to nothing.
        return torch.where(warp == _LEAST_WARP, torch.zeros_like(slope), slope)

    def _warp(self, hyper: Tensor) -> Tensor:
        warp = hyper[-1 - self.degree - self.n_features : -1 - self.degree]
        return torch.where(warp.abs() < _LEAST_WARP, torch.full_like(warp, _LEAST_WARP), warp)

    def near(self, hyper: Tensor, warped: Tensor) -> Tensor:
        """Return what bumps take of points, for all scales: (h,), (b, f) -> (b, f + 1 + s)."""
        # -|w - w'|²/2 = <w, w'> - |w|²/2 - |w'|²/2, so `near` times `far` is one matrix product per scale.
        halves = warped.square() @ (-0.5 * self.lengths(hyper).square().reciprocal()).mT
        return torch.cat([warped, torch.ones_like(warped[..., :1]), halves], dim=-1)

    def far(self, hyper: Tensor, warped: Tensor) -> Tensor:
        """Return what bumps take of rows, for each scale: (h,), (n, f) -> (s, f + 1 + s, n).

        `near` times this is the logarithm, to base 2, of the bumps.
        """
        inverse, rows = self.lengths(hyper).square().reciprocal(), warped.mT
        # The weight goes into the exponent, which saves a pass over the matrix.
        halves = self.weights(hyper).log()[:, None] - 0.5 * (inverse @ rows.square())  # (s, n)
        # Picks of all halves in `near` those of the own scale.
        own = torch.eye(self.n_scales, dtype=rows.dtype, device=rows.device)
        parts = [
            inverse[..., None] * rows,
            halves[:, None],
            own[:, :, None].expand(-1, -1, rows.shape[1]),
        ]
        # Here rather than on the product, which has n times m numbers.
        return torch.cat(parts, dim=1) * _LOG2_E

    def bumps(self, hyper: Tensor, near: Tensor, far: Tensor) -> Tensor:
        """Return the sum over the scales, of warped features: (h,), (n, f), (m, f) -> (n, m)."""
        points = self.near(hyper, near)
        # A generator: one matrix exists beside the sum, not one per scale.
        of_scales = ((points @ rows).exp2_() for rows in self.far(hyper, far))
        return functools.reduce(torch.add, of_scales)

    def products(self, hyper: Tensor, near: Tensor, far: Tensor) -> Tensor:
        """Return <w, w'>_1 of warped features: (h,), (n, f), (m, f) -> (n, m)."""
        return (near / self.lengths(hyper)[0].square()) @ far.mT

    def matrix(self, hyper: Tensor, x: Tensor, others: Tensor) -> Tensor:
        """Return the covariances without noise: (h,), (n, f), (m, f) -> (n, m)."""
        near, far = self.warped(hyper, x), self.warped(hyper, others)
        return self.on_trunk(hyper, self.bumps(hyper, near, far), self.products(hyper, near, far))

    def on_trunk(self, hyper: Tensor, bumps: Tensor, product: Tensor) -> Tensor:
        """Add constant and polynomial.

        Args:
            hyper: Hyperparameters. Shape (h,).
            bumps: Their sum. Shape of the products, or a number.
            product: Products of warped features, which are divided by the first scale's lengths.
        """
        # Horner's rule.
        *squares, last = self.polynomial(hyper)
        for square in reversed(squares):
            last = last * product + square
        return torch.addcmul(bumps, product, last).add_(CONSTANT)

    def noisy(self, hyper: Tensor, x: Tensor) -> Tensor:
        """Return the covariances of simulated rows, noise included: (h,), (n, f) -> (n, n)."""
        matrix = self.matrix(hyper, x, x)
        return matrix + self.noise(hyper, matrix) * torch.eye(len(x), dtype=x.dtype, device=x.device)

    def noise(self, hyper: Tensor, matrix: Tensor) -> Tensor:
        """Return what is added on the diagonal of covariances: (h,), (n, n) -> ()."""
        # A share of the trace, since rounding grows with the largest covariances, not with the noise.
        return (2.0 * hyper[-1]).exp() + JITTER * matrix.diagonal().sum()
