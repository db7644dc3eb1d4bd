"""A Gaussian process over the residuals of a calibration: what a model would answer, with its variance.

The whole residual vector is predicted, not its error: the mean squared error and its curvature follow from it
as in Gauss-Newton's method. All residuals share one kernel (residual_kernel.py) over features of the unit
cube: its coordinates and, for logarithmic parameters, the linear coordinate too: some effects are
proportional to a parameter, others to its logarithm, and the kernel's lengths say which.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.parameters import ParameterSpace
from studies.calibration.box_newton import Expansion
from studies.calibration.processes.kernel import (
    CONSTANT,
    Belief,
    between,
    inverse_factor,
    kernel_matrix,
    most_probable,
)

# Rows with factors of the noise variance below this one count alike. [1]
LEAST_LOOSENESS = 1e-8


@dataclass(frozen=True, eq=False)
class Features:
    """The coordinates in which the process is even.

    Attributes:
        log_width: Logarithm of upper by lower bound of the l logarithmic parameters. Shape (l,). [1]
        is_log: Which parameters those are. Shape (p,).
        acts: Which a parameters the process depends on, these among them. Shape (p,).
    """

    log_width: FloatArray
    is_log: BoolArray
    acts: BoolArray

    @classmethod
    def of(cls, space: ParameterSpace, parameters: IntArray | None = None) -> Self:
        """Return the features of a box, or of some of its parameters."""
        acts = np.zeros(space.n_parameters, dtype=np.bool_)
        acts[slice(None) if parameters is None else parameters] = True
        is_log = space.is_log & acts
        return cls(np.log(space.upper[is_log] / space.lower[is_log]), is_log, acts)

    def at(self, u: FloatArray) -> FloatArray:
        """Return the features of points, between -1/2 and 1/2. Shape (n, a + l). [1]."""
        # expm1 has all digits where a range is narrow and both differences are next to nothing.
        linear = np.expm1(self.log_width * u[..., self.is_log]) / np.expm1(self.log_width)
        return np.concatenate([u[..., self.acts], linear], axis=-1) - 0.5

    def pull_back(self, u: FloatArray, by_feature: FloatArray) -> FloatArray:
        """Turn derivatives by the features at one point into derivatives by its coordinates.

        Args:
            u: The point. Shape (p,). [1]
            by_feature: Derivatives of n values. Shape (n, a + l).

        Returns:
            Derivatives by the coordinates. Shape (n, p).
        """
        slope = self.log_width * np.exp(self.log_width * u[self.is_log]) / np.expm1(self.log_width)
        n_acting = by_feature.shape[-1] - slope.size
        by_u = np.zeros((*by_feature.shape[:-1], u.size))
        by_u[..., self.acts] = by_feature[..., :n_acting]
        by_u[..., self.is_log] += by_feature[..., n_acting:] * slope
        return by_u


@dataclass(frozen=True, eq=False)
class Components:
    """Residuals of n rows in an orthonormal basis of their differences to the best row, r components each.

    Attributes:
        values: The differences. Shape (n, r). [unit]
        level: Best row's residuals in the basis. Shape (r,). [unit]
        outside: Sum of squares of the best row's residuals outside the basis. [unit squared]
        best: Best row's residuals, or their coordinates. Shape (m,). [unit]
        n_residuals: Residuals in a row.
        looseness: Factors of the rows' noise variances, which grow with their errors: of a row far from the
            measurement a process need only know that it is far; near it, small differences decide.
            Shape (n,). [1]
    """

    values: FloatArray
    level: FloatArray
    outside: float
    best: FloatArray
    n_residuals: int
    looseness: FloatArray

    @classmethod
    def of(cls, residuals: FloatArray, power: int = 1, n_residuals: int | None = None) -> Self:
        """Return all components of rows.

        Args:
            residuals: The rows' residuals, or their coordinates in an orthonormal basis. Shape (n, m).
            power: Noise variances are errors to this power.
            n_residuals: Residuals in a row where coordinates are given, None for m.
        """
        squares = (residuals**2).sum(axis=1)
        best = residuals[int(np.argmin(squares))]
        # n rows differ in n directions at most: from here on,
        # work does not grow with the number of residuals.
        basis, triangle = np.linalg.qr((residuals - best).T)
        level = basis.T @ best
        size = float(np.square(triangle).sum()) / len(residuals)
        loose = (
            np.maximum((squares / size) ** power, LEAST_LOOSENESS) if size > 0.0 else np.ones(len(residuals))
        )
        m = best.size if n_residuals is None else n_residuals
        # Pythagoras: what the basis does not hold is the
        # difference of squares, which rounding may make negative.
        return cls(triangle.T, level, max(float((best**2).sum() - (level**2).sum()), 0.0), best, m, loose)

    def split(self, part: float) -> list[Self]:
        """Return the fewest components that hold a part of the differences' squares, and the others.

        The basis becomes that of the principal components. What is outside of it stays with the first.
        """
        squares, directions = np.linalg.eigh(self.values.T @ self.values)
        # eigh returns them rising, and with rounding some are negative.
        squares, directions = np.maximum(squares[::-1], 0.0), directions[:, ::-1]
        held = np.cumsum(squares)
        n_leading = int((held < part * held[-1]).sum()) + 1
        # A second group would hold rounding alone.
        if n_leading >= len(held) or held[n_leading - 1] == held[-1]:
            return [self]
        return [
            replace(self, values=self.values @ axes, level=self.level @ axes, outside=outside)
            for axes, outside in (
                (directions[:, :n_leading], self.outside),
                (directions[:, n_leading:], 0.0),
            )
        ]


@dataclass(frozen=True, eq=False)
class ResidualProcess:
    """A Gaussian process through residual vectors; make it with `fit`.

    The residuals are held in an orthonormal basis of their differences to the best row, r of them.

    Attributes:
        features: The coordinates that the kernel sees, f of them.
        x: The points in these. Shape (n, f). [1]
        hyper: Logarithms of f lengths, slope and noise. Shape (f + 2,). [1]
        inverse_factor: Inverse of the kernel matrix's Cholesky factor. Shape (n, n). [1]
        coefficients: Kernel matrix's inverse times the residuals. Shape (n, r). [unit]
        level: Best row's residuals in the basis. Shape (r,). [unit]
        outside: Sum of squares of the best row's residuals outside the basis. [unit squared]
        variance: Amplitude of the process, mean over the residuals. [unit squared]
        n_residuals: Residuals in a row, m.
    """

    features: Features
    x: FloatArray
    hyper: FloatArray
    inverse_factor: FloatArray
    coefficients: FloatArray
    level: FloatArray
    outside: float
    variance: float
    n_residuals: int

    @classmethod
    def fit(
        cls,
        features: Features,
        u: FloatArray,
        residuals: FloatArray,
        first_guess: FloatArray | None = None,
    ) -> Self:
        """Fit the process to rows that were simulated.

        Args:
            features: The coordinates that the kernel shall see.
            u: Points, at least two. Shape (n, p). [1]
            residuals: Their residuals, finite. Shape (n, m). [unit]
            first_guess: Hyperparameters of an earlier fit to start from. Shape (f + 2,). [1]
        """
        components, x = Components.of(residuals), features.at(u)
        belief = Belief.of(x.shape[1])
        hyper = most_probable(x, components.values, components.looseness, belief, first_guess)
        return cls.through(features, x, components, hyper)

    @classmethod
    def through(cls, features: Features, x: FloatArray, components: Components, hyper: FloatArray) -> Self:
        """Return the process with known hyperparameters (f + 2,) through components of rows at x (n, f)."""
        factor = inverse_factor(kernel_matrix(x, hyper, components.looseness)[0])
        coefficients = factor.T @ (factor @ components.values)
        m = components.n_residuals
        # The most probable amplitude in closed form: the trace of
        # the inverse kernel matrix times the Gram matrix, per value.
        variance = float((components.values * coefficients).sum()) / (len(x) * m)
        return cls(
            features, x, hyper, factor, coefficients, components.level, components.outside, variance, m
        )

    @cached_property
    def _weights(self) -> tuple[FloatArray, float]:
        """Inverse squared lengths of the features, shape (f,) [1], and the squared slope [1]."""
        return np.exp(-2.0 * self.hyper[:-2]), float(np.exp(2.0 * self.hyper[-2]))

    @cached_property
    def kernel(self) -> FloatArray:
        """The kernel matrix with the rows' noise. Shape (n, n). [1]."""
        factor = np.linalg.inv(self.inverse_factor)
        return np.asarray(factor @ factor.T)

    @cached_property
    def amplitudes(self) -> FloatArray:
        """Most probable amplitude of each component by itself. Shape (r,). [unit]."""
        squares = (self.kernel @ self.coefficients * self.coefficients).sum(axis=0)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0) / len(self.x)))

    def kernels(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the kernels of a point (p,) with the rows, shape (n,), and by its coordinates, (n, p)."""
        k, slopes = self.kernels_and_slopes(u)
        return k, slopes()

    def kernels_and_slopes(self, u: FloatArray) -> tuple[FloatArray, Callable[[], FloatArray]]:
        """Return the kernels of a point (p,) with the rows, and what makes the slopes of these, see above."""
        weights, slope = self._weights
        x = self.features.at(u)
        away = x - self.x
        bumps = np.exp(-0.5 * (away**2) @ weights)
        k = CONSTANT + bumps + slope * self.x @ (x * weights)
        return k, lambda: self.features.pull_back(u, (slope * self.x - bumps[:, None] * away) * weights)

    def expand(self, u: FloatArray, caution: float) -> Expansion:
        """Expand the expected error around a point.

        Args:
            u: The point. Shape (p,). [1]
            caution: Part of the predictive variance that is added to the squared mean. [1]
        """
        k, slopes = self.kernels_and_slopes(u)
        residuals = self.level + k @ self.coefficients
        mse = (self.outside + float(residuals @ residuals)) / self.n_residuals
        weights, slope = self._weights
        scale = caution * self.variance
        x, known, variance = self.features.at(u), np.empty(0), 0.0
        if caution > 0.0:  # half of the work is the variance
            known = self.inverse_factor @ k
            # Beside a row, rounding may make it negative.
            variance = max(CONSTANT + 1.0 + slope * float(x**2 @ weights) - float(known @ known), 0.0)

        def derivatives() -> tuple[FloatArray, FloatArray]:
            dk = slopes()
            jacobian = dk.T @ self.coefficients
            gradient = 2.0 * (jacobian @ residuals) / self.n_residuals
            # Gauss-Newton: without the residuals' own curvature it is never indefinite.
            hessian = 2.0 * (jacobian @ jacobian.T) / self.n_residuals
            if caution == 0.0:
                return gradient, hessian
            # Curvature of the variance: twice the covariance of the
            # slopes, and a rest that vanishes at the data.
            dknown = self.inverse_factor @ dk
            dprior = self.features.pull_back(u, slope * x * weights)
            # Variance of the slopes beforehand: the kernel's mixed
            # second derivative at distance zero, (1 + a²) / L².
            roots = self.features.pull_back(u, np.diag(np.sqrt((1.0 + slope) * weights)))
            gradient = gradient + 2.0 * scale * (dprior - dknown.T @ known)
            hessian = hessian + 2.0 * scale * (roots.T @ roots - dknown.T @ dknown)
            return gradient, hessian

        return Expansion(mse + scale * variance, mse, derivatives)

    def errors(self, u: FloatArray) -> FloatArray:
        """Return the mean squared errors at points (n, p) if the mean prediction is right. Shape (n,)."""
        k = between(self.features.at(u), self.x, self.hyper)
        residuals = self.level + k @ self.coefficients
        errors: FloatArray = (self.outside + np.sum(residuals**2, axis=1)) / self.n_residuals
        return errors

    def covariance(self, u: FloatArray) -> FloatArray:
        """Return what the rows leave of the covariance of a residual at points (n, p). Shape (n, n)."""
        x = self.features.at(u)
        known = self.inverse_factor @ between(self.x, x, self.hyper)
        return self.variance * (between(x, x, self.hyper) - known.T @ known)
