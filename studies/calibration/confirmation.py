"""Where a search that has settled may be wrong: the place in the box where a lower error is least unlikely.

A surrogate that expects nothing more around its best row may still be wrong along a valley, where its errors
are small and its variance is as small as what is left to gain. Such places are asked before a search says
that it has converged: where the answers gain something, it goes on.
"""

from functools import partial

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.box_newton import descend
from studies.calibration.elsewhere import Expand

# Worth asking for is an error below this part of the best one's: what counts as the right answer.
WORTH = 0.98
# An error whose residuals err by a variance v around a mean square m has about the variance
# 2 v (v + 2 m) / k, where k residuals vary independently: few, as few directions in the box are left unknown.
N_INDEPENDENT = 2.0
# Descents a round, each in the part of the box beyond these distances from the best row along one coordinate,
# and over the whole box.
DISTANCES, N_BEYOND, N_ANYWHERE = (0.2, 0.5), 12, 4
# Part of the variance that counts as error in what is expected; a place so near to a row is known.
CAUTION, KNOWN = 0.03, 0.02


def least_unlikely(
    expand: Expand,
    best: tuple[FloatArray, float],
    rows: tuple[FloatArray, BoolArray],
    n: int,
    rng: np.random.Generator,
) -> tuple[FloatArray, float]:
    """Return the places where an error worth having is least unlikely, and what is promised over the box.

    Args:
        expand: The surrogate.
        best: The best row, shape (p,) [1], and its objective. [unit squared]
        rows: All rows, shape (m, p) [1], and which of them succeeded, shape (m,).
        n: How many places, each beyond `KNOWN` of the others as far as there are such.
        rng: Source of the descents' starts.

    Returns:
        The places, shape (n, p), and the greatest relative gain over the best row that the surrogate
        expects in the box. [1]
    """
    (centre, objective), (u, good) = best, rows
    p = centre.size
    ends = [_beyond(expand, centre, rng) for _ in range(N_BEYOND)]
    mean = partial(expand, caution=0.0)
    ends += [descend(mean, start, np.zeros(p), np.ones(p))[0] for start in rng.random((N_ANYWHERE, p))]
    places = np.array(ends)
    distances = np.abs(places[:, None] - u[None]).max(axis=2)
    scores = np.array([_unlikely(expand, place, WORTH * objective) for place in places])
    promised = 1.0 - min(expand(place, caution=CAUTION).value for place in places) / objective
    # Where the nearest row failed, the next one probably fails as well.
    scores[~good[np.argmin(distances, axis=1)]] += np.ptp(scores) + 1.0
    scores[distances.min(axis=1) < KNOWN] = np.inf
    order = np.argsort(scores, kind="stable")
    chosen: list[int] = []
    for i in order:
        if all(float(np.abs(places[i] - places[j]).max()) > KNOWN for j in chosen):
            chosen.append(int(i))
    chosen += [int(i) for i in order if int(i) not in chosen]
    found = places[chosen[:n]]
    # Rounds larger than the descents are filled up with places anywhere.
    return np.concatenate([found, rng.random((n - len(found), p))]), promised


def _beyond(expand: Expand, centre: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return the minimum beyond a distance from the best row along a coordinate, all others free."""
    p = centre.size
    lower, upper, start = np.zeros(p), np.ones(p), centre.copy()
    j = int(rng.integers(p))
    distance = float(rng.choice(DISTANCES))
    # Towards a bound that is nearer than this, the other way.
    is_up = bool(rng.integers(2)) if distance <= centre[j] <= 1.0 - distance else centre[j] < 0.5
    start[j] = np.clip(centre[j] + (distance if is_up else -distance), 0.0, 1.0)
    (lower if is_up else upper)[j] = start[j]
    return descend(partial(expand, caution=CAUTION), start, lower, upper)[0]


def _unlikely(expand: Expand, u: FloatArray, wanted: float) -> float:
    """Return by how many deviations the error is expected to lie above a wanted one."""
    mean = expand(u, caution=0.0).value
    whole = expand(u, caution=1.0).value
    variance = max(whole - mean, 0.0)
    deviation = np.sqrt(2.0 * variance * (variance + 2.0 * mean) / N_INDEPENDENT)
    return float((whole - wanted) / max(deviation, 1e-9 * whole, np.finfo(float).tiny))
