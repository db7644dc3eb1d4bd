"""The part of an error that its largest samples make up: one wrong sample may hold nearly all of it.

A gain that is small beside such an error may be large beside what the other samples leave. So promises are
measured against the error without those samples. No sample is left out of what is minimized.
"""

import numpy as np

from simulation.arrays import FloatArray

FAR = 10.0
"""Residuals beyond so many times the median stand alone: of normal ones, one in 10^11 is beyond."""

VANISHING = 0.1
"""An error of this share of the sensor's uncertainty is none: beside it no gain is large. By hand."""

MOST, LEAST = 0.01, 2
"""Share and number of the samples that count as largest at most: a model that errs in more errs as a whole,
and a whitened wrong sample makes two residuals large. By hand."""


def largest_beyond(residuals: FloatArray, far: float = FAR) -> FloatArray:
    """Return the largest residuals that lie far beyond the median of them. Shape (k,). [unit].

    Args:
        residuals: Those of one simulation, finite. Shape (m,). [unit]
        far: How many times the median is far. [1]
    """
    sizes = np.abs(residuals)
    # Limits that are kept leave zeros, of which any number says nothing of the others.
    some = sizes[sizes > 0.0]
    n_most = min(max(int(MOST * sizes.size), LEAST), some.size)
    if not n_most:
        return some
    largest = np.partition(some, some.size - n_most)[some.size - n_most :]
    return np.asarray(largest[largest > far * np.median(some)])


def outlying_part(residuals: FloatArray, sensor: float) -> float:
    """Return what the largest samples make up of the mean of squares, so that the sensor sees the rest.

    Args:
        residuals: Those of one simulation. Shape (m,). [first output's unit]
        sensor: Uncertainty of the first output's sensor. [its unit]

    Returns:
        0 where residuals are not finite. [first output's unit squared]
    """
    whole = float(np.square(residuals).mean()) if residuals.size else 0.0
    if not np.isfinite(whole):
        return 0.0
    part = float(np.square(largest_beyond(residuals)).sum()) / max(residuals.size, 1)
    return min(part, max(whole - (VANISHING * sensor) ** 2, 0.0))
