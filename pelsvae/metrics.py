"""Prediction errors in the output's unit, as every comparison in this project states them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Errors:
    """Two summaries of the absolute prediction error over a data set. [first output's unit].

    Attributes:
        mae: Mean over rows, times and outputs.
        p90: 90th percentile over rows of the row's mean.
    """

    mae: float
    p90: float


def errors(
    predicted: npt.NDArray[np.float64],
    true: npt.NDArray[np.float64],
    output_scales: npt.NDArray[np.float64] | None = None,
) -> Errors:
    """Summarize the absolute errors of predicted trajectories.

    Args:
        predicted: Predicted outputs. Shape (n, t, k). [output's unit]
        true: Simulated outputs. Shape (n, t, k). [output's unit]
        output_scales: What makes errors of different units comparable, by which they are multiplied; None
            for 1. Shape (k,). [first output's unit / output's unit]

    Returns:
        Mean and 90th percentile of the absolute error.

    Raises:
        ValueError: The shapes differ, or there is no row.
    """
    if predicted.shape != true.shape or predicted.ndim != 3 or predicted.shape[0] == 0:
        raise ValueError(
            f"errors need two equal shapes (n, t, k), n > 0; got {predicted.shape} and {true.shape}"
        )
    error = np.abs(predicted - true)
    if output_scales is not None:
        error *= output_scales
    per_row = error.mean(axis=(1, 2))
    return Errors(mae=float(per_row.mean()), p90=float(np.percentile(per_row, 90)))
