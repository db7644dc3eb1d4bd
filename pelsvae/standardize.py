"""Maps between physical numbers (float64) and what the network sees (mean 0, deviation 1, float32).

The only place where precision changes. Fitted on the training set alone.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

Array = npt.NDArray[np.float64]
_CONSTANT = 1e-12  # deviation / magnitude below which a column holds rounding, not information


def safe_deviation(deviation: Array, magnitude: Array) -> Array:
    """Replace the deviation of constant columns by 1, so that they map to 0 instead of infinity.

    Args:
        deviation: Standard deviation per column. Shape (c,).
        magnitude: Largest absolute value per column. Shape (c,).

    Returns:
        Deviations that can be divided by. Shape (c,).
    """
    return np.where(deviation > _CONSTANT * magnitude, deviation, 1.0)


@dataclass(frozen=True)
class ThetaStandardizer:
    """theta to network features: standardized columns, then the standardized logarithms of some.

    Attributes:
        log_columns: Indices of the columns whose logarithm is a feature too. Shape (q,).
        mean: Of the features over the training set. Shape (p + q,).
        deviation: Of the features over the training set. Shape (p + q,).
    """

    log_columns: npt.NDArray[np.int64]
    mean: Array
    deviation: Array

    @staticmethod
    def fit(theta: Array, log_columns: npt.NDArray[np.bool_]) -> "ThetaStandardizer":
        """Take means and deviations from the training set.

        Args:
            theta: Training parameters. Shape (n, p). [per parameter]
            log_columns: Which columns get a logarithm. Shape (p,).

        Returns:
            The fitted map.
        """
        columns = np.flatnonzero(log_columns).astype(np.int64)
        features = np.concatenate([theta, np.log(theta[:, columns])], axis=1)  # (n, p + q)
        deviation = safe_deviation(features.std(axis=0), np.abs(features).max(axis=0))
        return ThetaStandardizer(columns, features.mean(axis=0), deviation)

    @property
    def n_features(self) -> int:
        """Number of features, p + q."""
        return self.mean.size

    @property
    def n_parameters(self) -> int:
        """Number of parameters, p."""
        return self.n_features - self.log_columns.size

    def features(self, theta: Tensor, dtype: torch.dtype) -> Tensor:
        """Map parameters to features; differentiable.

        Args:
            theta: Parameters, float64. Shape (..., p). [per parameter]
            dtype: Of the result.

        Returns:
            Features on theta's device. Shape (..., p + q). [1]
        """
        logarithms = theta[..., torch.as_tensor(self.log_columns, device=theta.device)].log()
        values = torch.cat([theta, logarithms], dim=-1)
        mean = torch.as_tensor(self.mean, device=theta.device)
        deviation = torch.as_tensor(self.deviation, device=theta.device)
        # Cast last: a difference of single-precision numbers would lose the digits that vary.
        return ((values - mean) / deviation).to(dtype)


@dataclass(frozen=True)
class OutputStandardizer:
    """Trajectories to network outputs: minus the mean per time and output, over one deviation per output.

    One deviation over all times, so that the mean squared error of Eq. 4 weighs a kelvin alike at every
    time, and a value that all simulations share (an initial condition) divides nothing by zero.

    Attributes:
        mean: Over the training set. Shape (t, k). [output's unit]
        deviation: Over training set and time. Shape (k,). [output's unit]
    """

    mean: Array
    deviation: Array

    @staticmethod
    def fit(y: Array) -> "OutputStandardizer":
        """Take mean and deviation from the training set.

        Args:
            y: Training trajectories. Shape (n, t, k). [output's unit]

        Returns:
            The fitted map.
        """
        mean = y.mean(axis=0)
        deviation = np.sqrt(np.square(y - mean).mean(axis=(0, 1)))
        return OutputStandardizer(mean, safe_deviation(deviation, np.abs(y).max(axis=(0, 1))))

    def standardized(self, y: Array) -> Array:
        """Map trajectories to flat network outputs.

        Args:
            y: Trajectories. Shape (n, t, k). [output's unit]

        Returns:
            Shape (n, t * k). [1]
        """
        return ((y - self.mean) / self.deviation).reshape(len(y), -1)

    def physical(self, x: Array) -> Array:
        """Map flat network outputs to trajectories; the inverse of `standardized`.

        Args:
            x: Network outputs. Shape (n, t * k). [1]

        Returns:
            Shape (n, t, k). [output's unit]
        """
        return x.reshape(-1, *self.mean.shape) * self.deviation + self.mean
