"""Where a search restarts after a search phase has ended: farther along its valley, or in another one."""

from collections.abc import Callable
from functools import partial

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import descend
from studies.calibration.residual_process import Expansion
from studies.calibration.search_constants import SEARCH

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
    away = SEARCH.away
    ends = [descend(cautious, u, np.maximum(u - away, 0.0), np.minimum(u + away, 1.0)) for u in starts]
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
    starts = rng.random((max(SEARCH.least_descents, SEARCH.descents_per_point * n), p))
    ends = [descend(mean, u, np.zeros(p), np.ones(p))[0] for u in starts]
    # Descents find other valleys of the mean, spread points find places of which next to nothing is known.
    points = np.array([*ends, *(margin + (1.0 - 2.0 * margin) * rng.random((max(SEARCH.n_spread, n), p)))])
    scores = [_excess_by_variance(expand, u, SEARCH.wanted * best) for u in points]
    order = [int(i) for i in np.argsort(scores, kind="stable")]
    chosen: list[int] = []
    for i in order:
        if all(float(np.abs(points[i] - points[j]).max()) > SEARCH.apart for j in chosen):
            chosen.append(i)
    # In a small box fewer may lie apart than are asked for.
    chosen += [i for i in order if i not in chosen]
    return np.asarray(points[chosen[:n]], dtype=np.float64)


def _excess_by_variance(expand: Expand, u: FloatArray, wanted: float) -> float:
    value = expand(u, caution=0.0).value
    variance = expand(u, caution=1.0).value - value
    return (value - wanted) / max(variance, LEAST_VARIANCE * value, np.finfo(float).tiny)
