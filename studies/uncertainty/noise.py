"""What residuals say about noise: how large it is, and how many independent samples a measurement is worth.

The calibration minimizes the MSE of m scaled residuals. A parameter set then is as likely as

    log L = -n / (2 s²) * MSE + constant,

with s the standard deviation of a residual and n <= m the samples that count as independent. White noise has
n = m. Residuals of a real model follow each other, because the model errs slowly: with correlation rho from
one sample to the next, m of them are worth m (1 - rho) / (1 + rho). That is exact for outputs that change
slowly against the noise and too careful for others, and it leaves the best parameters where they were found.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.measurement import Measurement
from studies.calibration.prior import independent_samples as declared_independent_samples
from studies.calibration.prior import worth_of

NoiseKind = Literal["correlated", "white", "sensor"]
NOISE_KINDS: tuple[NoiseKind, ...] = get_args(NoiseKind)


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
        """Deviation of white noise that tells as little. [first output's unit]."""
        return self.deviation * float(np.sqrt(self.n_samples / self.n_independent))

    def log_likelihood(self, mse: FloatArray) -> FloatArray:
        """Return how likely errors are, but for a constant.

        Args:
            mse: Mean squared errors. Shape (n,). [first output's unit squared]

        Returns:
            Shape (n,). [1]
        """
        value: FloatArray = -0.5 * self.n_independent / self.deviation**2 * mse
        return value

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers as JSON values."""
        return {
            "kind": self.kind,
            "deviation": self.deviation,
            "n_samples": self.n_samples,
            "n_independent": self.n_independent,
        }


def noise_of(kind: NoiseKind, measurement: Measurement, y: FloatArray, n_parameters: int) -> Noise:
    """Return the noise of a measurement, judged by the best simulation.

    Args:
        kind: Which model of the noise.
        measurement: What was measured.
        y: The best simulation. Shape (t, k). [per output]
        n_parameters: Parameters that were fitted to it.

    Raises:
        InputError: The residuals vanish.
    """
    m = measurement.n_samples
    if kind == "sensor":
        deviation = float(measurement.uncertainty[0])
        return Noise(kind, deviation, m, declared_independent_samples(measurement))
    parts = [measurement.differences(y[None], k)[0] * s for k, s in enumerate(measurement.scales)]
    squares = sum(float(part @ part) for part in parts)
    if squares <= 0.0:
        raise InputError(
            "the best simulation equals the measurement to the last digit, so its residuals show no noise; "
            "use --noise sensor"
        )
    deviation = float(np.sqrt(squares / max(m - n_parameters, 1)))
    n_independent = sum(independent_samples(part) for part in parts) if kind == "correlated" else float(m)
    return Noise(kind, deviation, m, n_independent)


def independent_samples(residuals: FloatArray) -> float:
    """Return how many independent samples residuals are worth, by their correlation from one to the next.

    Args:
        residuals: In the order of time. Shape (m,).
    """
    centered = residuals - residuals.mean()
    power = float(centered @ centered)
    if power <= 0.0 or len(residuals) < 3:
        return float(len(residuals))
    rho = min(max(float(centered[1:] @ centered[:-1]) / power, 0.0), 0.999)
    return worth_of(len(residuals), rho)
