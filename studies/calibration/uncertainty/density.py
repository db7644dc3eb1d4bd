"""How probable parameters are: by the model, and as a Gaussian process of its residuals expects it.

A process predicts a mean residual vector r and a covariance v(u) S of it: one variance v at a point, shared
by all residuals, times how these vary together. In S's eigenvectors the likelihood that is expected is

    E[exp(-|r|² / (2 s²))] = prod_i (1 + v S_i / s²)^(-1/2) exp(-r_i² / (2 (s² + v S_i))),

which is the likelihood of the mean where the process is sure, and wider where it is not: a sample of it goes
where the model may turn out well, and so can be reweighted by the model.
"""

from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.prior import Prior
from studies.calibration.processes.kernel import CONSTANT, between
from studies.calibration.processes.process import ResidualProcess
from studies.calibration.uncertainty.identifiability import BOX_PRECISION
from studies.calibration.uncertainty.noise import Noise

# Memory then does not grow with the points asked: a block's covariances with 400 rows take 1.6 MB.
BLOCK = 512
"""Points that are predicted at once."""


@dataclass(frozen=True, eq=False)
class Posterior:
    """The logarithm of a density in the unit cube, even before the data but for a prior that is declared.

    Attributes:
        noise: What errors say.
        prior: What was known beforehand, or None.
    """

    noise: Noise
    prior: Prior | None

    def at(self, u: FloatArray, mse: FloatArray) -> FloatArray:
        """Return the density's logarithm where errors are known, but for a constant.

        Args:
            u: Points. Shape (n, p). [1]
            mse: Their errors, infinite where a simulation failed. Shape (n,). [first output's unit squared]

        Returns:
            Shape (n,). [1]
        """
        return self._with_prior(u, self.noise.log_likelihood(mse))

    def by(self, predicted: "Predicted", u: FloatArray, *, caution: float = 1.0) -> FloatArray:
        """Return the density's logarithm as a process expects it.

        Args:
            predicted: What it predicts.
            u: Points. Shape (n, p). [1]
            caution: Part of what not being sure takes off: 1 for what is expected, less to look farther. [1]

        Returns:
            Shape (n,). [1]
        """
        # Features need points of the cube; outside it the density becomes minus infinity below.
        inside = np.clip(u, 0.0, 1.0)
        return self._with_prior(u, predicted.log_likelihood(inside, self.noise.raised, caution))

    def precision(self, metric: FloatArray, *, wider: float) -> FloatArray:
        """Return the precision of what may lie around points: narrow where the density is.

        Args:
            metric: How fast the residuals change there, in noise: J' J / s². Shape (n, p, p). [1]
            wider: How much wider than the density; but never wider than the box. [1]

        Returns:
            Shape (n, p, p). [1]
        """
        p = metric.shape[-1]
        # An infinite width has precision 0: no prior adds nothing.
        widths = np.full(p, np.inf) if self.prior is None else self.prior.width
        precision: FloatArray = (metric + np.diag(widths**-2.0)) / wider**2
        # After the division: the box is not widened. Three times the box, next to no draw fell inside it.
        return precision + BOX_PRECISION * np.eye(p)

    def _with_prior(self, u: FloatArray, value: FloatArray) -> FloatArray:
        if self.prior is not None:
            value = value - 0.5 * np.sum(self.prior.deviations(u) ** 2, axis=1)
        inside = np.all((u >= 0.0) & (u <= 1.0), axis=1)
        return np.where(inside, value, -np.inf)


def roots_of(precision: FloatArray) -> FloatArray:
    """Return the lower factors of the covariances (n, p, p) of precisions, however narrow and long. [1]."""
    sizes, axes = np.linalg.eigh(precision)
    # Rounding leaves nothing of a direction that the data leave open beside a far narrower one.
    half = axes / np.sqrt(np.maximum(sizes, BOX_PRECISION))[:, None, :]
    # Cholesky factor by QR of a root: forming the covariance itself would square the condition.
    upper = np.linalg.qr(half.transpose(0, 2, 1))[1]
    # QR leaves the signs open; a Cholesky factor has a positive diagonal, whose logarithm is taken later.
    signs = np.sign(np.diagonal(upper, axis1=1, axis2=2))
    return (upper * np.where(signs == 0.0, 1.0, signs)[:, :, None]).transpose(0, 2, 1)


class Predicted:
    """What a process predicts at many points at once."""

    def __init__(self, process: ResidualProcess) -> None:
        """Prepare what does not depend on the points."""
        self._process = process
        # L^-1 r: as the amplitude is profiled out, its most probable value S is r' K^-1 r / n.
        whitened = np.linalg.solve(process.inverse_factor.T, process.coefficients)
        # In the eigenvectors of S the residuals are independent, so the likelihood is a product.
        shared, directions = np.linalg.eigh(whitened.T @ whitened / len(process.x))
        # Rounding makes vanishing eigenvalues negative.
        self._shared = np.maximum(shared, 0.0)
        self._level = process.level @ directions
        self._coefficients = process.coefficients @ directions

    def residuals(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Predict the residuals of points.

        Args:
            u: Points. Shape (n, p). [1]

        Returns:
            Their mean in the eigenvectors of S, and the variance v. Shape (n, r) and (n,). [unit], [1]
        """
        process = self._process
        x, hyper = process.features.at(u), process.hyper
        k = between(x, process.x, hyper)
        explained = np.sum((k @ process.inverse_factor.T) ** 2, axis=1)
        own = CONSTANT + 1.0 + np.sum((np.exp(hyper[-2] - hyper[:-2]) * x) ** 2, axis=1)
        # At a stored row equal numbers are subtracted: rounding must not leave a negative variance.
        variance = np.maximum(own - explained, 0.0)
        return self._level + k @ self._coefficients, variance

    def metric(self, u: FloatArray, deviation: float) -> FloatArray:
        """Return how fast the residuals change, in noise: J' J / s² with what is not sure left out.

        Args:
            u: Points. Shape (n, p). [1]
            deviation: Of white noise, s. [unit]

        Returns:
            Shape (n, p, p). [1]
        """
        by_u = np.stack([self._process.kernels(point)[1] for point in u])
        _, variance = self.residuals(u)
        # Where the process is unsure its slopes count less, as if the noise were larger there.
        roots = np.sqrt(deviation**2 + variance[:, None] * self._shared)
        jacobian = np.swapaxes(by_u, 1, 2) @ self._coefficients / roots[:, None, :]
        return jacobian @ np.swapaxes(jacobian, 1, 2)

    def log_likelihood(self, u: FloatArray, deviation: float, caution: float = 1.0) -> FloatArray:
        """Return the logarithm of the expected likelihood, but for the model's constant.

        Args:
            u: Points. Shape (n, p). [1]
            deviation: Of white noise, s. [unit]
            caution: Exponent of the product. [1]

        Returns:
            Shape (n,). [1]
        """
        parts = []
        for start in range(0, len(u), BLOCK):
            residuals, variance = self.residuals(u[start : start + BLOCK])
            # The logarithm is the factor that a wide distribution loses: with less of it particles
            # leave the stored rows.
            total = deviation**2 + variance[:, None] * self._shared
            parts.append(-0.5 * np.sum(residuals**2 / total + caution * np.log(total / deviation**2), axis=1))
        # What all rows share outside the basis: a constant, but the model's density has it too.
        outside = self._process.outside / deviation**2
        return np.concatenate(parts) - 0.5 * outside if parts else np.empty(0)
