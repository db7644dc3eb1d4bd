"""How probable parameters are, by a Gaussian process of the residuals instead of the model itself."""

from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.prior import Prior
from studies.calibration.residual_process import CONSTANT, ResidualProcess
from studies.uncertainty.noise import Noise

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
        value = self.noise.log_likelihood(mse)
        if self.prior is not None:
            value = value - 0.5 * np.sum(self.prior.deviations(u) ** 2, axis=1)
        inside = np.all((u >= 0.0) & (u <= 1.0), axis=1)
        return np.where(inside, value, -np.inf)

    def by(self, process: ResidualProcess, u: FloatArray, caution: float) -> FloatArray:
        """Return the density's logarithm as a process expects it.

        Args:
            process: Predicts residuals.
            u: Points. Shape (n, p). [1]
            caution: Part of the predictive variance that counts as error. [1]

        Returns:
            Shape (n,). [1]
        """
        return self.at(u, expected_mse(process, np.clip(u, 0.0, 1.0), caution))


def expected_mse(process: ResidualProcess, u: FloatArray, caution: float) -> FloatArray:
    """Return what `ResidualProcess.expand` does, its value alone and at many points.

    Args:
        process: Predicts residuals.
        u: Points. Shape (n, p). [1]
        caution: Part of the predictive variance that counts as error. [1]

    Returns:
        Shape (n,). [unit squared]
    """
    weights, slope = np.exp(-2.0 * process.hyper[:-2]), float(np.exp(2.0 * process.hyper[-2]))
    known = process.x * np.sqrt(weights)
    known_squares = np.sum(known**2, axis=1)
    parts = []
    for start in range(0, len(u), BLOCK):
        x = process.features.at(u[start : start + BLOCK]) * np.sqrt(weights)
        products, squares = x @ known.T, np.sum(x**2, axis=1)
        distances = np.maximum(squares[:, None] + known_squares - 2.0 * products, 0.0)
        k = CONSTANT + np.exp(-0.5 * distances) + slope * products
        residuals = process.level + k @ process.coefficients
        explained = k @ process.inverse_factor.T
        variance = CONSTANT + 1.0 + slope * squares - np.sum(explained**2, axis=1)
        mse = (process.outside + np.sum(residuals**2, axis=1)) / process.n_residuals
        parts.append(mse + caution * process.variance * np.maximum(variance, 0.0))
    return np.concatenate(parts) if parts else np.empty(0)
