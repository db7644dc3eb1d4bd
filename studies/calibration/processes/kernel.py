"""The kernel of the residual processes, and its most probable hyperparameters.

    k(x, x') = c² + exp(-|d|²/2) + a² <x, x'>_L,    d_i = (x_i - x'_i) / L_i,

with one length L_i per feature and a linear part <., .>_L in the same lengths: far from the data a process
goes on as a linear model instead of falling back to its mean. A row's noise grows with its error.
Lengths, slope a and noise are the most probable ones; the amplitude is profiled out. Cost: n³ for n points,
whatever the number of residuals.
"""

from typing import NamedTuple, Self

import numpy as np
from scipy.linalg import lapack
from scipy.optimize import minimize

from simulation.arrays import FloatArray

# Variance c² of the constant, relative to the bumps': the mean is as good as unknown.
CONSTANT = 10.0

# Normal priors of the logarithms: mean and standard deviation. The unit cube is 1 wide.
LENGTH_PRIOR = (np.log(1.5), 1.0)
SLOPE_PRIOR = (np.log(1.0), 1.0)  # of the linear part, relative to the bumps
# Noise of a row that differs from the measurement as much as rows differ, relative to that.
NOISE_PRIOR = (np.log(1e-2), 0.5)
# Far outside of the priors: they keep the search finite.
LENGTH_BOUNDS = (np.log(0.05), np.log(50.0))
SLOPE_BOUNDS = (np.log(1e-3), np.log(50.0))  # likewise
# With 0.1 at most instead of 0.3, two of five searches from stored rows
# never arrived (docs/notes/adaptive-search.md, Stored simulations).
NOISE_BOUNDS = (np.log(1e-5), np.log(0.3))
# Relative to the kernel matrix's trace: what rounding may cost before a factor no longer exists.
JITTER = 1e-13

# Residuals of one trajectory are far from independent; this many count as independent in the likelihood.
N_INDEPENDENT = 12.0
# Principal components of the residuals that are smaller than the first one by this factor are rounding.
NEGLIGIBLE = 1e-8
# A fit goes on where the last one stopped.
MAX_FIT_ITERATIONS = 15
# Hyperparameters are kept to so many digits: rounding noise of one fit does not grow into the next.
FIT_DECIMALS = 4


class Belief(NamedTuple):
    """The prior of hyperparameters, and how many values of a row count as independent.

    Attributes:
        mean: Of their logarithms: f lengths, slope and noise. Shape (f + 2,). [1]
        deviation: Of the same. Shape (f + 2,). [1]
        n_independent: Values of a row that count as independent.
    """

    mean: FloatArray
    deviation: FloatArray
    n_independent: float

    @classmethod
    def of(cls, n_features: int, noise: tuple[float, float] = NOISE_PRIOR) -> Self:
        """Return the prior of any model."""
        mean, deviation = np.array([LENGTH_PRIOR] * n_features + [SLOPE_PRIOR, noise]).T
        return cls(mean, deviation, N_INDEPENDENT)


def kernel_matrix(
    x: FloatArray, hyper: FloatArray, looseness: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the kernel matrix of a design with its noise, its bumps and its linear part. Shapes (n, n).

    Args:
        x: Points. Shape (n, f). [1]
        hyper: Hyperparameters. Shape (f + 2,). [1]
        looseness: Factors of the rows' noise variances. Shape (n,). [1]
    """
    scaled = x * np.exp(-hyper[:-2])
    # Distances as |a|² + |b|² - 2 <a, b>: one matrix product, which the linear part needs anyway.
    products = scaled @ scaled.T
    squares = np.diag(products)
    # With rounding, equal points may have a negative distance.
    distances = np.maximum(squares[:, None] + squares[None] - 2.0 * products, 0.0)
    bumps = np.exp(-0.5 * distances)
    linear = np.exp(2.0 * hyper[-2]) * products
    matrix = CONSTANT + bumps + linear
    noise = np.exp(2.0 * hyper[-1]) * looseness + JITTER * float(np.trace(matrix))
    return matrix + np.diag(noise), bumps, linear


def between(x: FloatArray, others: FloatArray, hyper: FloatArray) -> FloatArray:
    """Return the covariances of points (n, f) with others (m, f), hyperparameters (f + 2,). Shape (n, m)."""
    shrink = np.exp(-hyper[:-2])
    x, others = x * shrink, others * shrink
    products = x @ others.T
    squares = np.sum(x**2, axis=1)[:, None] + np.sum(others**2, axis=1)
    covariances: FloatArray = (
        CONSTANT
        + np.exp(-0.5 * np.maximum(squares - 2.0 * products, 0.0))
        + np.exp(2.0 * hyper[-2]) * products
    )
    return covariances


def most_probable(
    x: FloatArray, values: FloatArray, looseness: FloatArray, belief: Belief, first_guess: FloatArray | None
) -> FloatArray:
    """Return the hyperparameters that maximize the profiled likelihood times the priors. Shape (f + 2,).

    Args:
        x: Points. Shape (n, f). [1]
        values: The rows' residuals, in any orthonormal basis. Shape (n, r). [unit]
        looseness: Factors of the rows' noise variances. Shape (n,). [1]
        belief: The priors.
        first_guess: Where the search begins, the priors' mean when None. Shape (f + 2,). [1]
    """
    n, f = x.shape
    mean, deviation, n_independent = belief
    total = float(np.square(values).sum())
    # Rows that all answer alike teach nothing.
    if total <= 0.0:
        return mean
    # The amplitude is profiled out, so that scale is free: with a trace of n all numbers are of size 1.
    values = _leading(values * np.sqrt(n / total))

    def loss(hyper: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = _negative_log_likelihood(x, values, looseness, hyper, n_independent)
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


def _leading(values: FloatArray) -> FloatArray:
    """Return principal components of rows (n, r) without those of rounding. Shape (n, k)."""
    directions, sizes, _ = np.linalg.svd(values, full_matrices=False)
    n_kept = int((sizes > NEGLIGIBLE * sizes[0]).sum())
    return np.asarray(directions[:, :n_kept] * sizes[:n_kept], dtype=np.float64)


def _negative_log_likelihood(
    x: FloatArray, values: FloatArray, looseness: FloatArray, hyper: FloatArray, n_independent: float
) -> tuple[float, FloatArray]:
    """Return -log p of the residuals (n, r), amplitude profiled out, and its gradient."""
    n = len(x)
    matrix, bumps, linear = kernel_matrix(x, hyper, looseness)
    inverse, log_determinant = _inverse(matrix)
    weighed = inverse @ values
    trace = float((values * weighed).sum())
    # Negative log marginal likelihood (Rasmussen and Williams
    # 2006, Eq. 5.8) at its best amplitude, trace / n.
    value = 0.5 * n_independent * (log_determinant + n * np.log(trace / n))
    # d value / d kernel matrix
    slopes = 0.5 * n_independent * (inverse - (n / trace) * (weighed @ weighed.T))
    gradient = np.empty(hyper.size)
    bumps = slopes * bumps
    # With S symmetric, sum S_ij (x_i - x_j)² = 2 (sum s_i x_i² - x' S x): two products serve all lengths.
    mixed = (bumps + np.exp(2.0 * hyper[-2]) * slopes) @ x
    gradient[:-2] = 2.0 * np.exp(-2.0 * hyper[:-2]) * (bumps.sum(axis=1) @ (x**2) - (x * mixed).sum(axis=0))
    gradient[-2] = 2.0 * (slopes * linear).sum()
    gradient[-1] = 2.0 * np.exp(2.0 * hyper[-1]) * (np.diag(slopes) * looseness).sum()
    return value, gradient


def _inverse(matrix: FloatArray) -> tuple[FloatArray, float]:
    """Return a positive definite matrix's inverse, shape (n, n), and its determinant's logarithm."""
    factor = np.linalg.cholesky(matrix)
    # From the factor alone, in half of the operations that its inverse and a product take.
    half, _ = lapack.dpotri(factor, lower=1)
    inverse = half + half.T
    np.fill_diagonal(inverse, np.diag(half))
    return np.asarray(inverse, dtype=np.float64), 2.0 * float(np.log(np.diag(factor)).sum())


def inverse_factor(matrix: FloatArray) -> FloatArray:
    """Return the inverse of the lower Cholesky factor. Shape (n, n)."""
    # Inverted once, as slopes of the likelihood and variances at many points then are plain products.
    inverse, _ = lapack.dtrtri(np.linalg.cholesky(matrix), lower=1)
    return np.asarray(inverse, dtype=np.float64)
