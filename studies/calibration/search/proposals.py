"""The points of a round: where the surrogate expects the least error, and where it would learn most.

A point that is asked alone is the surrogate's favourite. Of points that are asked together, more favourites
lie near the first and add little to it; so half of them go where the variance is greatest, among places that
may be as good.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import SAME_POINT, Expansion, descend
from studies.calibration.search.expected_objective import CAUTION, ExpectedObjective
from studies.calibration.search.first_design import within

# Descents on the surrogate per point, the first from the centre. By hand.
N_DESCENTS = 3
# Places may be as good whose objective is expected to be greater by this part, in the mean of random ones and
# at most (docs/notes/adaptive-search.md, Rounds of several points).
MEAN_SPREAD, MOST_SPREAD = 0.02, 0.06
# Places among which the informative points of a round are chosen. By hand.
N_PLACES = 200

# Relative to the greatest variance: below, two points carry the same information.
SAME_INFORMATION = 1e-6
LEAST_CURVATURE = 1e-8  # relative to the sum of all


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The trust region of a round and what is known there.

    Attributes:
        objective: What is expected of it.
        centre: The row that the search phase goes on from. Shape (p,). [1]
        radius: Half width of the trust region. [1]
        known: Points that were simulated. Shape (n, p). [1]
        n_descents: Descents for a favourite, the first from the centre.
    """

    objective: ExpectedObjective
    centre: FloatArray
    radius: float
    known: FloatArray
    n_descents: int


def favourites(surroundings: Surroundings, n: int, rng: np.random.Generator) -> tuple[FloatArray, Expansion]:
    """Return the favourite and what is expected of it, and favourites with other radii and cautions.

    Args:
        surroundings: Where to look.
        n: Points.
        rng: Source of the descents' starts.

    Returns:
        The points, of shape (n, p), and the first one's expansion.
    """
    centre, points, expansions = surroundings.centre, list[FloatArray](), list[Expansion]()
    for rank in range(n):
        lower, upper = within(centre, min(surroundings.radius * (1.0, 0.5, 2.0)[rank % 3], 1.0))
        # Half decades, by turns less and more than the favourite's: a round has bold and careful points.
        caution = float(CAUTION * 10.0 ** (0.5 * ((rank + 1) // 2) * (-1.0) ** rank))
        # Descents from the next best rows cost 3 to 9 % more calls
        # (docs/notes/adaptive-search.md, Rounds of several points).
        starts = [centre, *rng.uniform(lower, upper, (surroundings.n_descents - 1, centre.size))]
        expand = partial(surroundings.objective.expand, caution=caution)
        ends = [descend(expand, start, lower, upper) for start in starts]
        u, expected = min(ends, key=lambda end: end[1].value)
        known = np.array([*surroundings.known, *points])
        if float(np.abs(known - u).max(axis=1).min()) < SAME_POINT:
            # The same point again would teach nothing.
            u = rng.uniform(centre - 0.3 * (centre - lower), centre + 0.3 * (upper - centre))
        points.append(u)
        expansions.append(expected)
    return np.array(points), expansions[0]


def informative(
    surroundings: Surroundings,
    asked: FloatArray,
    favourite: Expansion,
    n: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Return the points of greatest variance, each once those before it are known.

    They are chosen among places around the favourite that may be as good by the surrogate's curvature there.

    Args:
        surroundings: Where to look.
        asked: Points of the same round, the favourite first. Shape (m, p). [1]
        favourite: What is expected of it.
        n: Points.
        rng: Source of the places.

    Returns:
        Shape (n, p). [1]
    """
    p, (lower, upper) = surroundings.centre.size, within(surroundings.centre, surroundings.radius)
    expected = surroundings.objective
    objective = float(expected.at(surroundings.centre[None])[0])
    # Of steps drawn with this variance times the inverse of the curvature the mean costs `spread`.
    # Draws of 10 % and of 0.5 % gained no more (docs/notes/adaptive-search.md, Rounds of several points).
    variance = 2.0 * MEAN_SPREAD * objective / p
    # At an error of zero rounding may make the curvature indefinite.
    ridge = max(variance / surroundings.radius**2, LEAST_CURVATURE * np.trace(favourite.hessian))
    ridge += np.finfo(float).tiny
    factor = np.linalg.cholesky(favourite.hessian + ridge * np.eye(p))
    n_places = max(N_PLACES, 2 * n)
    # The factor's inverse times normal draws has the inverse curvature as covariance: no inverse is formed.
    steps = np.sqrt(variance) * np.linalg.solve(factor.T, rng.standard_normal((p, n_places))).T
    places = np.clip(asked[0] + steps, lower, upper)
    excess = expected.at(places) - favourite.value
    # A tenth of the places remains where all are expected to be worse.
    n_least = max(n, n_places // 10)
    places = places[excess <= max(MOST_SPREAD * objective, float(np.sort(excess)[n_least - 1]))]
    left = expected.process.covariance(np.concatenate([asked, places]))
    least = SAME_INFORMATION * float(np.diag(left).max()) + np.finfo(float).tiny
    # Points of the same round count as simulated first: what they will show is not asked for twice.
    order = list(range(len(asked)))
    for rank in range(len(asked) + n):
        if rank >= len(asked):
            variances = np.diag(left).copy()
            variances[: len(asked)] = variances[order] = -np.inf
            order.append(int(np.argmax(variances)))
        one = order[rank]
        # Conditioning on one point is an update of rank one,
        # as in a Cholesky factorization; nothing is inverted.
        left = left - np.outer(left[one], left[one]) / (left[one, one] + least)
    chosen: FloatArray = places[np.array(order[len(asked) :]) - len(asked)]
    return chosen
