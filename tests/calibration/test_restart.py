"""Where a search restarts, and when its surrogate has erred."""

from functools import partial

import numpy as np
import pytest
from problems_for_tests import rc_problem
from toy_rc import ToyRC

from simulation.arrays import FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.processes.process import Features
from studies.calibration.search.expected_objective import ExpectedObjective
from studies.calibration.search.restart import least_excluded
from studies.calibration.search.rows import Incumbent


def two_valleys(u: FloatArray, *, caution: float, unsure_at: float) -> Expansion:
    """Bottoms of 1.0 at 0.2, known, and of 1.1 at 0.8; the variance is 3 around `unsure_at`."""
    known, other = 1.0 + 50.0 * (u[0] - 0.2) ** 2, 1.1 + 50.0 * (u[0] - 0.8) ** 2
    mse, bottom = min((known, 0.2), (other, 0.8))
    variance = 3.0 * float(abs(u[0] - unsure_at) < 0.1)
    slope = np.array([100.0 * (u[0] - bottom)])
    return Expansion.known(mse + caution * variance, mse, slope, np.array([[100.0]]))


@pytest.mark.parametrize(("unsure_at", "tolerance"), [(0.8, 1e-3), (0.5, 0.1)])
def test_another_valley_is_sought_or_where_all_are_known_the_least_known_place(
    unsure_at: float, tolerance: float
) -> None:
    expand = partial(two_valleys, unsure_at=unsure_at)
    found = least_excluded(expand, Incumbent(0, np.array([0.2]), 1.0), (1, 1), np.random.default_rng(0))
    assert found[0, 0] == pytest.approx(unsure_at, abs=tolerance)


def test_a_known_row_is_surely_no_better_than_itself_and_an_unknown_place_may_be() -> None:
    problem = rc_problem(noise=0.05)
    u = 0.3 * np.random.default_rng(0).random((8, 2))
    residuals = problem.residuals(u)
    process = ProcessGroups.fit(Features.of(ToyRC().parameter_space), u, residuals)
    objective = ExpectedObjective(process)
    best = int(np.argmin((residuals**2).mean(axis=1)))
    incumbent = Incumbent(best, u[best], float((residuals[best] ** 2).mean()))
    for point, is_sure in ((u[best], True), (np.array([0.9, 0.9]), False)):
        expected = objective.expand(point, 0.1)
        assert objective.excludes(point, expected, incumbent) is is_sure
