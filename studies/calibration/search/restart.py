"""Where a search restarts after a search phase: farther along its valley, or near another local minimum."""

from collections.abc import Callable
from functools import partial

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import Expansion, descend
from studies.calibration.search.expected_objective import CAUTION
from studies.calibration.search.first_design import inside, within
from studies.calibration.search.rows import Incumbent

# A restart farther along is the surrogate's minimum within this distance of a random point. By hand.
AWAY = 0.5
# Descents, at least and per point, and spread points among which a restart far away is chosen. By hand.
LEAST_DESCENTS, DESCENTS_PER_POINT, N_SPREAD = 20, 4, 100
# Another local minimum is worth a restart if its error may be this part of the best
# (docs/notes/adaptive-search.md, When an error above the sensor's uncertainty ends the search).
WANTED = 0.5
# Distance between restarts of one round. By hand.
RESTARTS_APART = 0.05

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
    cautious = partial(expand, caution=CAUTION)
    starts = inside(rng.random(shape))
    return np.array([descend(cautious, u, *within(u, AWAY))[0] for u in starts])


def least_excluded(
    expand: Expand, best: Incumbent, shape: tuple[int, int], rng: np.random.Generator
) -> FloatArray:
    """Return points whose predicted excess over a wanted error is the least multiple of its variance.

    Args:
        expand: The surrogate.
        best: The best simulation; its largest samples are as large near another local minimum.
        shape: How many points, and of how many coordinates.
        rng: Source of the descents' starts and the spread points.

    Returns:
        The points, the least excluded first. Shape as asked. [1]
    """
    n, p = shape
    mean = partial(expand, caution=0.0)
    starts = rng.random((max(LEAST_DESCENTS, DESCENTS_PER_POINT * n), p))
    ends = [descend(mean, u)[0] for u in starts]
    # Descents find other minima of the mean, spread points find places of which next to nothing is known.
    points = np.array([*ends, *inside(rng.random((max(N_SPREAD, n), p)))])
    wanted = WANTED * best.rest + best.outlying
    scores = [_excess_by_variance(expand, u, wanted) for u in points]
    return first_apart(points, np.array(scores), RESTARTS_APART)[:n]


def first_apart(points: FloatArray, scores: FloatArray, distance: float) -> FloatArray:
    """Return points (n, p) by rising score (n,), those first that lie so far from all before them."""
    order = np.argsort(scores, kind="stable").tolist()
    chosen: list[int] = []
    for i in order:
        if all(float(np.abs(points[i] - points[j]).max()) > distance for j in chosen):
            chosen.append(i)
    # Within narrow bounds fewer may lie apart than are asked for.
    return np.asarray(points[[*chosen, *(i for i in order if i not in chosen)]])


def _excess_by_variance(expand: Expand, u: FloatArray, wanted: float) -> float:
    value = expand(u, caution=0.0).value
    variance = expand(u, caution=1.0).value - value
    return (value - wanted) / max(variance, LEAST_VARIANCE * value, np.finfo(float).tiny)
