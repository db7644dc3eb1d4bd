"""Tests of a search that has settled: minima of functions drawn from the surrogate's posterior.

A surrogate that expects no more gain around its best row may still be wrong, along a valley or in another
one. So functions are drawn from its posterior, each is minimized over the whole box, and the place that most
probably is better is simulated. How much lower these minima lie than the best row says whether the search has
converged.
"""

from functools import partial

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.box_newton import descend
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.processes.posterior_sample import PosteriorSample
from studies.calibration.search.constants import SEARCH
from studies.calibration.search.expected_objective import expected_objective
from studies.calibration.search.failures import Penalty
from studies.calibration.search.restart import first_apart


def least_unlikely(
    process: ProcessGroups,
    prior: Penalty | None,
    best: tuple[FloatArray, float],
    rows: tuple[FloatArray, BoolArray],
    n: int,
    rng: np.random.Generator,
    *,
    outlying: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return the places where an error worth having is least unlikely, and what the functions promise.

    Args:
        process: The surrogate.
        prior: What is added to the error, None for nothing.
        best: The best row, shape (p,) [1], and its objective. [unit squared]
        rows: All rows, shape (m, p) [1], and which of them succeeded, shape (m,).
        n: How many places, each beyond `known` of the others as far as there are such.
        rng: Source of the functions and of the descents' starts.
        outlying: Part of the objective that is its largest samples', without which gains are measured.
            [unit squared]

    Returns:
        The places, shape (n, p), and by which part of the best row's objective the functions' minima lie
        below it, shape (d,). [1]
    """
    (centre, objective), (u, good) = best, rows
    rest = objective - outlying
    p = centre.size
    ends = []
    for anywhere in rng.random((SEARCH.n_drawn, p)):
        sample = PosteriorSample.draw(process, rng)
        expand = partial(expected_objective, sample, prior, caution=0.0)
        # From random points alone none came near an oscillator's valley: a search "converged"
        # at 1.065 times (docs/notes/adaptive-search.md, Convergence, later in version 0.3).
        for start in (anywhere, centre):
            # Another valley, and what the rows leave open of this one.
            ends.append(descend(expand, start, np.zeros(p), np.ones(p), ftol=SEARCH.rough))
    places = np.array([place for place, _ in ends])
    values = np.array([there.value for _, there in ends]).reshape(SEARCH.n_drawn, 2)
    gains = 1.0 - (values.min(axis=1) - outlying) / rest
    distances = np.abs(places[:, None] - u[None]).max(axis=2)
    wanted = SEARCH.worth * rest + outlying
    scores = np.array([_unlikely(process, prior, place, wanted) for place in places])
    # Where the nearest row failed, the next one probably fails as well.
    # They come after all others, in the order among themselves.
    scores[~good[np.argmin(distances, axis=1)]] += np.ptp(scores) + 1.0
    scores[distances.min(axis=1) < SEARCH.known] = np.inf
    found = first_apart(places, scores, SEARCH.known)[:n]
    # Rounds larger than the descents are filled up with places anywhere.
    return np.concatenate([found, rng.random((n - len(found), p))]), gains


def _unlikely(process: ProcessGroups, prior: Penalty | None, u: FloatArray, wanted: float) -> float:
    """Return by how many deviations the error is expected to lie above a wanted one."""
    mean = expected_objective(process, prior, u, 0.0).value
    whole = expected_objective(process, prior, u, 1.0).value
    variance = max(whole - mean, 0.0)
    # A mean of n squares of normal values is noncentral chi-squared: its variance is 2 v (v + 2 m) / n.
    deviation = np.sqrt(2.0 * variance * (variance + 2.0 * mean) / SEARCH.n_independent_errors)
    return float((whole - wanted) / max(deviation, 1e-9 * whole, np.finfo(float).tiny))
