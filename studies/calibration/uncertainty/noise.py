"""What residuals say about noise: how large it is, and how many independent samples a measurement is worth.

The calibration minimizes the MSE of m scaled residuals. A parameter set then is as likely as

    log L = -n / (2 s²) * MSE + constant,

with s the standard deviation of a residual and n <= m the samples that count as independent. White noise has
n = m. Residuals of a real model follow each other, because the model errs slowly: with correlation rho from
one sample to the next, m of them are worth m (1 - rho) / (1 + rho). That is exact for outputs that change
slowly against the noise and too careful for others, and it leaves the best parameters where they were found.

Fitted parameters take away the slow part of the noise, so what is left of it is smaller and seems less
correlated. Each of p takes away what one independent sample holds, a share p / n of the variance and of the
covariance from one sample to the next, as in restricted maximum likelihood (Patterson and Thompson 1971,
doi:10.1093/biomet/58.3.545); put back, both give n and s.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from simulation.arrays import FloatArray
from simulation.measurement import Measurement
from studies.calibration.prior import independent_samples as declared_independent_samples
from studies.calibration.prior import worth_of

NoiseKind = Literal["correlated", "white", "sensor"]

# With as many parameters as independent samples the correction would divide by 0.
MOST_TAKEN = 0.5
"""Share of the noise's variance that fitted parameters are thought to take away at most."""


@dataclass(frozen=True)
class Noise:
    """A noise model with its numbers.

    Attributes:
        kind: "correlated": as large as the residuals, which follow each other; "white": as large as the
            residuals, all independent; "sensor": as large as the sensor's uncertainty, independent but for
            what the case declares.
        deviation: Standard deviation of a residual, s. [first output's unit]
        n_samples: Residuals, m.
        n_independent: Samples that count as independent, n.
    """

    kind: NoiseKind
    deviation: float
    n_samples: int
    n_independent: float

    @property
    def raised(self) -> float:
        """Deviation of white noise that says as little. [first output's unit]."""
        return self.deviation * float(np.sqrt(self.n_samples / self.n_independent))

    @property
    def unit(self) -> float:
        """What a mean squared error rises by where -2 log L does by 1. [first output's unit squared]."""
        return self.deviation**2 / self.n_independent

    def log_likelihood(self, mse: FloatArray) -> FloatArray:
        """Return how likely errors are, but for a constant.

        Args:
            mse: Mean squared errors. Shape (n,). [first output's unit squared]

        Returns:
            Shape (n,). [1]
        """
        # Normal: Student's t, with the size left open, gave no better shares for 168 instead of 124 calls.
        return -0.5 * self.n_independent / self.deviation**2 * mse


def noise_of(kind: NoiseKind, measurement: Measurement, y: FloatArray, n_parameters: int) -> Noise:
    """Return the noise by which everything judges what a measurement determines, from the best simulation.

    It is the sensor's, whatever the kind, where that leaves more open than the residuals: small residuals
    alone, as those of data without noise, would call everything determined.

    Args:
        kind: Which model of the noise.
        measurement: What was measured.
        y: The best simulation. Shape (t, k). [per output]
        n_parameters: Parameters that were fitted to it.
    """
    m, sensor = measurement.n_samples, float(measurement.uncertainty[0])
    # The sensor's deviation is no estimate, so there is nothing that a fit took from it.
    declared = Noise("sensor", sensor, m, declared_independent_samples(measurement))
    # Limits that are kept show no noise.
    if kind == "sensor" or not measurement.measured:
        return declared
    shown = _shown(kind, measurement, y, n_parameters)
    return declared if shown.raised < declared.raised else shown


def _shown(
    kind: Literal["correlated", "white"], measurement: Measurement, y: FloatArray, n_parameters: int
) -> Noise:
    """Return the noise that the residuals of a simulation (t, k) show."""
    m = measurement.n_samples
    parts = [measurement.scatter(y, k) for k in measurement.measured]
    n_measured = sum(len(part) for part in parts)
    # Limits that are kept say nothing of noise, but all residuals are scaled by the number of all of them.
    squares = sum(float(part @ part) for part in parts) * (n_measured / m)
    if kind == "white":
        # m - p degrees of freedom make the estimate of the variance unbiased.
        return Noise(kind, float(np.sqrt(squares / max(n_measured - n_parameters, 1))), m, float(n_measured))
    # Which output a parameter was fitted to is not known: each bears them by its number of samples.
    n_independent = sum(independent_samples(part, n_parameters * len(part) / n_measured) for part in parts)
    # Each parameter took what one independent sample holds; without this, intervals were half as wide.
    left = 1.0 - min(n_parameters / n_independent, MOST_TAKEN)
    return Noise(kind, float(np.sqrt(squares / n_measured / left)), m, n_independent)


def independent_samples(residuals: FloatArray, n_fitted: float = 0.0) -> float:
    """Return how many independent samples noise is worth, by its correlation from one sample to the next.

    Args:
        residuals: What a fit left of it, in the order of time. Shape (m,).
        n_fitted: Parameters that were fitted, p.
    """
    centered = residuals - residuals.mean()
    power = float(centered @ centered)
    if power <= 0.0 or len(residuals) < 3:
        return float(len(residuals))
    # Below 0 samples would count as more than their number, at 1 as none.
    rho = min(max(float(centered[1:] @ centered[:-1]) / power, 0.0), 0.999)
    m = len(residuals)
    # With x = p / n put back, rho = r + x (1 - r): n = m (1 - rho) / (1 + rho) becomes quadratic in n.
    half = 0.5 * max(m - n_fitted, 0.0) * (1.0 - rho) / (1.0 + rho)
    # The larger root: without fitted parameters it is m (1 - rho) / (1 + rho).
    # Where too many were fitted there is no real root.
    found = half + float(np.sqrt(max(half**2 - worth_of(m, rho) * n_fitted, 0.0)))
    return max(found, 1.0)
