"""Tests of a search that has settled: minima of functions drawn from the surrogate's posterior.

A surrogate that expects no more gain around the best simulation may still be wrong, along a valley or near
another local minimum. So functions are drawn from its posterior, any of which may be the model. Each is
minimized within all bounds, and the place that most probably is better is simulated. Between rounds of tests
the search restarts away from its best point. Only tests and restarts since the last gain count. The search
has converged where these minima lie hardly lower than the best simulation.
"""

from dataclasses import dataclass, field

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.box_newton import descend
from studies.calibration.search.expected_objective import ExpectedObjective
from studies.calibration.search.restart import first_apart
from studies.calibration.search.rows import Incumbent

# Relative gain below which earlier tests still count: half of what makes an answer wrong.
CONFIRMED = 1e-2
# A search has converged where this quantile of the functions that tests draw promises at most this gain: an
# answer is right up to 1.02 times the best error (docs/notes/adaptive-search.md, Convergence, later).
PROMISED, QUANTILE = 0.02, 0.9
# Restarts without gain before a search may converge, each between two rounds of tests: per call, restarts
# gained two to three times as often as tests (the same section).
RESTARTS_OWED = 3
# The same of a single parameter, whose range a few simulations fill: of 80 searches with one none ended
# wrong, in 11 to 30 calls instead of 15 to 44 (medians of four problems).
RESTARTS_OWED_TO_ONE = 1
# Restarts without gain after which a search above the misfit threshold stops anyway (the same note,
# Convergence).
MOST_RESTARTS = 8
# A test is worth a call where the error may be this part of the best: a right answer, 1.02 times.
WORTH_A_TEST = 0.98
# Residuals that vary independently where an error's variance is estimated: few, as few directions within the
# bounds are left unknown. By hand.
N_INDEPENDENT_ERRORS = 2.0
# Functions that a round of tests draws (the same note, Convergence).
N_DRAWN = 16
# Relative gain at which a descent on such a function ends. By hand.
ROUGH = 2e-3
# A place so near to a simulation is known. By hand.
KNOWN = 0.02


@dataclass
class Confirmation:
    """What has been tested since the last gain.

    Attributes:
        best: Best objective at that gain. [unit squared]
        n_restarts: Restarts since then.
        gains: Of every round of tests the relative gains at minima of functions drawn for it. [1]
        n_owed: Restarts without gain before a search may converge.
    """

    best: float = np.inf
    n_restarts: int = 0
    gains: list[FloatArray] = field(default_factory=list)
    n_owed: int = RESTARTS_OWED

    def after(self, best: Incumbent) -> "Confirmation":
        """Return the tests that still count at a best simulation: none made before a gain."""
        # `best` moves at such a gain alone, so that many small gains together count as one.
        is_gain = best.rest < (1.0 - CONFIRMED) * (self.best - best.outlying)
        return Confirmation(best.objective, n_owed=self.n_owed) if is_gain else self

    def note_test(self, gains: FloatArray) -> None:
        """Take note of a round of tests."""
        self.gains.append(gains)

    @property
    def n_tested(self) -> int:
        """Rounds of tests."""
        return len(self.gains)

    @property
    def promised(self) -> float:
        """Gain over the best row at minima of functions that may be the true one, a quantile. [1]."""
        return float(np.quantile(self.gains, QUANTILE)) if self.gains else np.inf

    @property
    def is_promising(self) -> bool:
        """Whether more gain is promised than what makes an answer wrong."""
        return self.promised > PROMISED

    @property
    def is_tested(self) -> bool:
        """Whether there was a round of tests since the last restart."""
        return self.n_tested > self.n_restarts

    @property
    def has_looked(self) -> bool:
        """Whether the restarts that are owed were made."""
        return self.n_restarts >= self.n_owed


def least_unlikely(
    objective: ExpectedObjective,
    best: Incumbent,
    rows: tuple[FloatArray, BoolArray],
    n: int,
    rng: np.random.Generator,
) -> tuple[FloatArray, FloatArray]:
    """Return the places where an error worth having is least unlikely, and what the functions promise.

    Args:
        objective: What is expected.
        best: The best simulation.
        rows: The points of all simulations, shape (m, p) [1], and which of them succeeded, shape (m,).
        n: How many places, each beyond `known` of the others as far as there are such.
        rng: Source of the functions and of the descents' starts.

    Returns:
        The places, shape (n, p), and by which part of the best row's objective the functions' minima lie
        below it, shape (d,). [1]
    """
    u, good = rows
    p = best.u.size
    ends = []
    for anywhere in rng.random((N_DRAWN, p)):
        drawn = objective.drawn(rng)
        # From random points alone none came near an oscillator's minimum: a search "converged"
        # at 1.065 times (docs/notes/adaptive-search.md, Convergence, later in version 0.3).
        for start in (anywhere, best.u):
            # Another local minimum, and what the simulations leave open of this one.
            ends.append(descend(drawn, start, ftol=ROUGH))
    places = np.array([place for place, _ in ends])
    values = np.array([there.value for _, there in ends]).reshape(N_DRAWN, 2)
    gains = 1.0 - (values.min(axis=1) - best.outlying) / best.rest
    distances = np.abs(places[:, None] - u[None]).max(axis=2)
    wanted = WORTH_A_TEST * best.rest + best.outlying
    scores = np.array([_unlikely(objective, place, wanted) for place in places])
    # Where the nearest row failed, the next one probably fails as well.
    # They come after all others, in the order among themselves.
    scores[~good[np.argmin(distances, axis=1)]] += np.ptp(scores) + 1.0
    scores[distances.min(axis=1) < KNOWN] = np.inf
    found = first_apart(places, scores, KNOWN)[:n]
    # Rounds larger than the descents are filled up with places anywhere.
    return np.concatenate([found, rng.random((n - len(found), p))]), gains


def _unlikely(objective: ExpectedObjective, u: FloatArray, wanted: float) -> float:
    """Return by how many deviations the error is expected to lie above a wanted one."""
    mean, whole = (objective.expand(u, caution).value for caution in (0.0, 1.0))
    variance = max(whole - mean, 0.0)
    # A mean of n squares of normal values is noncentral chi-squared: its variance is 2 v (v + 2 m) / n.
    deviation = np.sqrt(2.0 * variance * (variance + 2.0 * mean) / N_INDEPENDENT_ERRORS)
    return float((whole - wanted) / max(deviation, 1e-9 * whole, np.finfo(float).tiny))
