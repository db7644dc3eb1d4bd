"""A Gaussian process over the residuals of a calibration: what a model would answer, and how sure that is.

The whole residual vector is predicted, not its error: the mean squared error and its curvature follow from it
as in Gauss-Newton's method. All residuals share one kernel over features x of the unit cube,

    k(x, x') = c² + exp(-|d|²/2) + a² <x, x'>_L,    d_i = (x_i - x'_i) / L_i,

with one length L_i per feature and a linear part <., .>_L in the same lengths: far from the data the process
goes on as a linear model instead of falling back to its mean. The features are the coordinates of the cube
and, for logarithmic parameters, the linear coordinate too: some effects are proportional to a parameter,
others to its logarithm, and the lengths say which. A row's noise is relative to its own residuals. Lengths,
slope a and noise are the most probable ones; the amplitude is profiled out. Cost: n³ for n points, whatever
the number of residuals.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize

from simulation.arrays import BoolArray, FloatArray
from simulation.parameters import ParameterSpace

# Variance c² of the constant, relative to the bumps': the mean is as good as unknown.
CONSTANT = 10.0

# Normal priors of the logarithms: mean and standard deviation. The unit cube is 1 wide.
LENGTH_PRIOR = (np.log(1.5), 1.0)
SLOPE_PRIOR = (np.log(1.0), 1.0)
# Noise of a row relative to its own residuals.
NOISE_PRIOR = (np.log(1e-2), 0.5)
# Rows this much closer to the measurement than the rows are to each other count alike. [squared]
LEAST_LOOSENESS = 1e-8
# Components of the residuals far above this multiple of the best row's error count by their root.
LARGE = 10.0
LENGTH_BOUNDS = (np.log(0.05), np.log(50.0))
SLOPE_BOUNDS = (np.log(1e-3), np.log(50.0))
NOISE_BOUNDS = (np.log(1e-5), np.log(0.3))
# Relative to the kernel matrix's trace: what rounding may cost before a factor no longer exists.
JITTER = 1e-13

# Residuals of one trajectory are far from independent; this many count as independent in the likelihood.
N_INDEPENDENT = 12.0
# A fit goes on where the last one stopped.
MAX_FIT_ITERATIONS = 15
# Hyperparameters are kept to so many digits: rounding noise of one fit does not grow into the next.
FIT_DECIMALS = 4


@dataclass(frozen=True, eq=False)
class Expansion:
    """Expected mean squared error around a point, to second order.

    Attributes:
        value: Squared mean prediction plus caution times the variance. [unit squared]
        mse: The first part alone: the error if the mean prediction is right. [unit squared]
        gradient: Shape (p,). [unit squared]
        hessian: Positive semidefinite part, as in Gauss-Newton's method. Shape (p, p). [unit squared]
    """

    value: float
    mse: float
    gradient: FloatArray
    hessian: FloatArray


@dataclass(frozen=True, eq=False)
class Features:
    """The coordinates in which the process is even.

    Attributes:
        log_width: Logarithm of upper by lower bound of the logarithmic parameters. Shape (l,). [1]
        is_log: Which parameters those are. Shape (p,).
    """

    log_width: FloatArray
    is_log: BoolArray

    @classmethod
    def of(cls, space: ParameterSpace) -> "Features":
        """Return the features of a box."""
        is_log = space.is_log
        return cls(np.log(space.upper[is_log] / space.lower[is_log]), is_log)

    def at(self, u: FloatArray) -> FloatArray:
        """Return the features of points, between -1/2 and 1/2. Shape (n, p + l). [1]."""
        linear = np.expm1(self.log_width * u[..., self.is_log]) / np.expm1(self.log_width)
        return np.concatenate([u, linear], axis=-1) - 0.5

    def pull_back(self, u: FloatArray, by_feature: FloatArray) -> FloatArray:
        """Turn derivatives by the features at one point into derivatives by its coordinates.

        Args:
            u: The point. Shape (p,). [1]
            by_feature: Derivatives of n values. Shape (n, p + l).

        Returns:
            Derivatives by the coordinates. Shape (n, p).
        """
        slope = self.log_width * np.exp(self.log_width * u[self.is_log]) / np.expm1(self.log_width)
        by_u = by_feature[..., : u.size].copy()
        by_u[..., self.is_log] += by_feature[..., u.size :] * slope
        return by_u


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
        *,
        balance: bool = False,
    ) -> "ResidualProcess":
        """Fit the process to rows that were simulated.

        Args:
            features: The coordinates that the kernel shall see.
            u: Points, at least two. Shape (n, p). [1]
            residuals: Their residuals, finite. Shape (n, m). [unit]
            first_guess: Hyperparameters of an earlier fit to start from. Shape (f + 2,). [1]
            balance: Whether lengths are to suit small components of the residuals as well as large ones.
        """
        n, m = residuals.shape
        best = int(np.argmin((residuals**2).sum(axis=1)))
        basis, triangle = np.linalg.qr((residuals - residuals[best]).T)
        values = triangle.T
        level = basis.T @ residuals[best]
        outside = max(float((residuals[best] ** 2).sum() - (level**2).sum()), 0.0)
        x = features.at(u)
        gram = values @ values.T
        looseness = _looseness(residuals, gram)
        weighed = balanced(gram, residuals[best]) if balance else gram
        hyper = _most_probable(x, weighed, looseness, first_guess)
        inverse_factor = _inverse_factor(_Kernel.of(x, hyper, looseness).matrix)
        coefficients = inverse_factor.T @ (inverse_factor @ values)
        variance = float((values * coefficients).sum()) / (n * m)
        return cls(features, x, hyper, inverse_factor, coefficients, level, outside, variance, m)

    def expand(self, u: FloatArray, caution: float) -> Expansion:
        """Expand the expected error around a point.

        Args:
            u: The point. Shape (p,). [1]
            caution: Part of the predictive variance that is added to the squared mean. [1]
        """
        weights, slope = np.exp(-2.0 * self.hyper[:-2]), float(np.exp(2.0 * self.hyper[-2]))
        x = self.features.at(u)
        away = x - self.x
        bumps = np.exp(-0.5 * (away**2) @ weights)
        k = CONSTANT + bumps + slope * self.x @ (x * weights)
        dk = self.features.pull_back(u, (slope * self.x - bumps[:, None] * away) * weights)
        residuals, jacobian = self.level + k @ self.coefficients, dk.T @ self.coefficients
        mse = (self.outside + float(residuals @ residuals)) / self.n_residuals
        gradient = 2.0 * (jacobian @ residuals) / self.n_residuals
        hessian = 2.0 * (jacobian @ jacobian.T) / self.n_residuals
        # Curvature of the variance: twice the covariance of the slopes, and a rest that vanishes at the data.
        known, dknown = self.inverse_factor @ k, self.inverse_factor @ dk
        variance = max(CONSTANT + 1.0 + slope * float(x**2 @ weights) - float(known @ known), 0.0)
        dprior = self.features.pull_back(u, slope * x * weights)
        roots = self.features.pull_back(u, np.diag(np.sqrt((1.0 + slope) * weights)))
        scale = caution * self.variance
        gradient = gradient + 2.0 * scale * (dprior - dknown.T @ known)
        hessian = hessian + 2.0 * scale * (roots.T @ roots - dknown.T @ dknown)
        return Expansion(mse + scale * variance, mse, gradient, hessian)


@dataclass(frozen=True, eq=False)
class _Kernel:
    """The kernel matrix of a design and its parts."""

    matrix: FloatArray
    bumps: FloatArray
    linear: FloatArray

    @classmethod
    def of(cls, x: FloatArray, hyper: FloatArray, looseness: FloatArray) -> "_Kernel":
        scaled = x * np.exp(-hyper[:-2])
        products = scaled @ scaled.T
        squares = np.diag(products)
        distances = np.maximum(squares[:, None] + squares[None] - 2.0 * products, 0.0)
        bumps = np.exp(-0.5 * distances)
        linear = np.exp(2.0 * hyper[-2]) * products
        matrix = CONSTANT + bumps + linear
        noise = np.exp(2.0 * hyper[-1]) * looseness + JITTER * float(np.trace(matrix))
        return cls(matrix + np.diag(noise), bumps, linear)


def balanced(gram: FloatArray, best: FloatArray) -> FloatArray:
    """Return the Gram matrix with its large components scaled down. Shape (n, n). [unit squared].

    What moves the residuals most would else decide alone, also the lengths of what hardly moves them.

    Args:
        gram: Products of the rows' residuals. Shape (n, n). [unit squared]
        best: Best row's residuals. Shape (m,). [unit]
    """
    squares, directions = np.linalg.eigh(gram)
    squares = np.maximum(squares, 0.0)
    scale = np.sqrt(squares / len(gram) + LARGE * float(best @ best) + np.finfo(float).tiny)
    return np.asarray((directions * (squares / scale)) @ directions.T, dtype=np.float64)


def _looseness(residuals: FloatArray, gram: FloatArray) -> FloatArray:
    """Return the factors of the rows' noise variances. Shape (n,). [1].

    Of a row far from the measurement the process need only know that it is far; near it, small differences
    decide.
    """
    squares = (residuals**2).sum(axis=1)
    size = float(np.trace(gram)) / len(gram)
    if size <= 0.0:
        return np.ones(len(gram))
    return np.asarray(np.maximum(squares / size, LEAST_LOOSENESS), dtype=np.float64)


def _most_probable(
    x: FloatArray, gram: FloatArray, looseness: FloatArray, first_guess: FloatArray | None
) -> FloatArray:
    """Return the hyperparameters that maximize the profiled likelihood times the priors. Shape (f + 2,)."""
    n, f = x.shape
    mean = np.array([LENGTH_PRIOR[0]] * f + [SLOPE_PRIOR[0], NOISE_PRIOR[0]])
    deviation = np.array([LENGTH_PRIOR[1]] * f + [SLOPE_PRIOR[1], NOISE_PRIOR[1]])
    total = float(np.trace(gram))
    if total <= 0.0:
        return mean
    gram = gram * (n / total)

    def loss(hyper: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = _negative_log_likelihood(x, gram, looseness, hyper)
        step = (hyper - mean) / deviation
        return value + 0.5 * float(step @ step), gradient + step / deviation

    found = minimize(
        loss,
        mean if first_guess is None else first_guess,
        jac=True,
        method="L-BFGS-B",
        bounds=[LENGTH_BOUNDS] * f + [SLOPE_BOUNDS, NOISE_BOUNDS],
        options={"maxiter": MAX_FIT_ITERATIONS},
    )
    return np.asarray(np.round(found.x, FIT_DECIMALS), dtype=np.float64)


def _negative_log_likelihood(
    x: FloatArray, gram: FloatArray, looseness: FloatArray, hyper: FloatArray
) -> tuple[float, FloatArray]:
    """Return -log p of the residuals' Gram matrix, amplitude profiled out, and its gradient."""
    n = len(x)
    kernel = _Kernel.of(x, hyper, looseness)
    factor = _inverse_factor(kernel.matrix)
    inverse = factor.T @ factor
    explained = inverse @ gram
    trace = float(np.trace(explained))
    value = 0.5 * N_INDEPENDENT * (-2.0 * float(np.log(np.diag(factor)).sum()) + n * np.log(trace / n))
    # d value / d kernel matrix
    slopes = 0.5 * N_INDEPENDENT * (inverse - (n / trace) * (explained @ inverse))
    gradient = np.empty(hyper.size)
    bumps = slopes * kernel.bumps
    mixed = (bumps + np.exp(2.0 * hyper[-2]) * slopes) @ x
    gradient[:-2] = 2.0 * np.exp(-2.0 * hyper[:-2]) * (bumps.sum(axis=1) @ (x**2) - (x * mixed).sum(axis=0))
    gradient[-2] = 2.0 * (slopes * kernel.linear).sum()
    gradient[-1] = 2.0 * np.exp(2.0 * hyper[-1]) * (np.diag(slopes) * looseness).sum()
    return value, gradient


def _inverse_factor(matrix: FloatArray) -> FloatArray:
    """Return the inverse of the lower Cholesky factor. Shape (n, n)."""
    inverse, _ = lapack.dtrtri(np.linalg.cholesky(matrix), lower=1)
    return np.asarray(inverse, dtype=np.float64)
