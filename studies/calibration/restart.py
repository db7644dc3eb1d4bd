"""Where a search restarts after a search phase has ended: farther along its valley, or in another one."""

from collections.abc import Callable
from functools import partial

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import descend
from studies.calibration.residual_process import Expansion

# Farther along is the surrogate's minimum within this distance of a random point.
AWAY = 0.5
# Descents on the mean prediction find the valleys that the surrogate expects; points that are merely spread
# serve where it expects none but the known one.
LEAST_DESCENTS, DESCENTS_PER_POINT = 20, 4
N_SPREAD = 100
# Another valley is worth while if its error may be this part of the best one's.
WANTED = 0.5
APART = 0.05
# Relative to the error: a prediction's variance is at least this.
LEAST_VARIANCE = 1e-9


Expand = Callable[..., Expansion]
"""The surrogate's error around a point of the unit cube, with a part of its variance: takes `caution`."""


def farther_along(
    expand: Expand, caution: float, shape: tuple[int, int], margin: float, rng: np.random.Generator
) -> FloatArray:
    """Return the surrogate's minima around points drawn anew.

    Args:
        expand: The surrogate.
        caution: Part of its variance that counts as error. [1]
        shape: How many points, and of how many coordinates.
        margin: Part of each coordinate's range where none is drawn, at both ends. [1]
        rng: Source of the draws.

    Returns:
        The minima. Shape as asked. [1]
    """
    starts = margin + (1.0 - 2.0 * margin) * rng.random(shape)
    cautious = partial(expand, caution=caution)
    ends = [descend(cautious, u, np.maximum(u - AWAY, 0.0), np.minimum(u + AWAY, 1.0)) for u in starts]
    return np.array([u for u, _ in ends])


def least_excluded(
    expand: Expand,
    best: float,
    shape: tuple[int, int],
    margin: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return points whose predicted excess over a wanted error is the least multiple of its variance.

    Args:
        expand: The surrogate.
        best: Objective of the best row. [unit squared]
        shape: How many points, and of how many coordinates.
        margin: Part of each coordinate's range where no spread point lies, at both ends. [1]
        rng: Source of the descents' starts and the spread points.

    Returns:
        The points, the least excluded first. Shape as asked. [1]
    """
    n, p = shape
    mean = partial(expand, caution=0.0)
    starts = rng.random((max(LEAST_DESCENTS, DESCENTS_PER_POINT * n), p))
    ends = [descend(mean, u, np.zeros(p), np.ones(p))[0] for u in starts]
    points = np.array([*ends, *(margin + (1.0 - 2.0 * margin) * rng.random((max(N_SPREAD, n), p)))])
    scores = [_excess_by_variance(expand, u, WANTED * best) for u in points]
    order = [int(i) for i in np.argsort(scores, kind="stable")]
    chosen: list[int] = []
    for i in order:
        if all(float(np.abs(points[i] - points[j]).max()) > APART for j in chosen):
            chosen.append(i)
    # In a small box fewer may lie apart than are asked for.
    chosen += [i for i in order if i not in chosen]
    return np.asarray(points[chosen[:n]], dtype=np.float64)


def _excess_by_variance(expand: Expand, u: FloatArray, wanted: float) -> float:
    value = expand(u, caution=0.0).value
    variance = expand(u, caution=1.0).value - value
    return (value - wanted) / max(variance, LEAST_VARIANCE * value, np.finfo(float).tiny)
