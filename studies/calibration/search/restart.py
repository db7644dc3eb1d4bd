"""Where a search restarts after a search phase has ended: farther along its valley, or in another one."""

from collections.abc import Callable
from functools import partial

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import Expansion, descend
from studies.calibration.search.constants import SEARCH

# Relative to the error: a prediction's variance is at least this.
LEAST_VARIANCE = 1e-9


Expand = Callable[..., Expansion]
"""The surrogate's error around a point of the unit cube, with a part of its variance: takes `caution`."""


def farther_along(expand: Expand, shape: tuple[int, int], rng: np.random.Generator) -> FloatArray:
    """Return the surrogate's minima around points drawn anew.

    Args:
        expand: The surrogate.
        shape: How many points, and of how many coordinates.
        rng: Source of the draws.

    Returns:
        The minima. Shape as asked. [1]
    """
    cautious = partial(expand, caution=SEARCH.caution)
    away, starts = SEARCH.away, inside(rng.random(shape))
    return np.array(
        [descend(cautious, u, np.maximum(u - away, 0.0), np.minimum(u + away, 1.0))[0] for u in starts]
    )


def least_excluded(
    expand: Expand, best: float, shape: tuple[int, int], rng: np.random.Generator, *, outlying: float = 0.0
) -> FloatArray:
    """Return points whose predicted excess over a wanted error is the least multiple of its variance.

    Args:
        expand: The surrogate.
        best: Objective of the best row. [unit squared]
        shape: How many points, and of how many coordinates.
        rng: Source of the descents' starts and the spread points.
        outlying: Part of the best objective that is its largest samples', which another valley has as well.
            [unit squared]

    Returns:
        The points, the least excluded first. Shape as asked. [1]
    """
    n, p = shape
    mean = partial(expand, caution=0.0)
    starts = rng.random((max(SEARCH.least_descents, SEARCH.descents_per_point * n), p))
    ends = [descend(mean, u, np.zeros(p), np.ones(p))[0] for u in starts]
    # Descents find other valleys of the mean, spread points find places of which next to nothing is known.
    points = np.array([*ends, *inside(rng.random((max(SEARCH.n_spread, n), p)))])
    wanted = SEARCH.wanted * (best - outlying) + outlying
    scores = [_excess_by_variance(expand, u, wanted) for u in points]
    return first_apart(points, np.array(scores), SEARCH.apart)[:n]


def inside(u: FloatArray) -> FloatArray:
    """Return points of the unit cube moved into the part of it that a margin leaves."""
    return SEARCH.margin + (1.0 - 2.0 * SEARCH.margin) * u


def first_apart(points: FloatArray, scores: FloatArray, distance: float) -> FloatArray:
    """Return points (n, p) by rising score (n,), those first that lie so far from all before them."""
    order = np.argsort(scores, kind="stable").tolist()
    chosen: list[int] = []
    for i in order:
        if all(float(np.abs(points[i] - points[j]).max()) > distance for j in chosen):
            chosen.append(i)
    # In a small box fewer may lie apart than are asked for.
    return np.asarray(points[[*chosen, *(i for i in order if i not in chosen)]])


def _excess_by_variance(expand: Expand, u: FloatArray, wanted: float) -> float:
    value = expand(u, caution=0.0).value
    variance = expand(u, caution=1.0).value - value
    return (value - wanted) / max(variance, LEAST_VARIANCE * value, np.finfo(float).tiny)
