"""The parts of an adaptive search, each alone: trust region, search phase, simulations and their window."""

import numpy as np
import pytest
from problems_for_tests import TRUE_RC, FailsInBand, rc_problem
from toy_rc import ToyRC

from studies.calibration.search.confirmation import CONFIRMED, Confirmation
from studies.calibration.search.rows import DIVERGED, Incumbent, Rows
from studies.calibration.search.search_phase import (
    STAGNANT,
    STAGNANT_ROUNDS,
    STAGNANT_ROUNDS_AWAY,
    STALL_GAIN,
    STALL_ROUNDS,
    SearchPhase,
)
from studies.calibration.search.trust_region import (
    FIRST_RADIUS,
    GROW,
    LEAST_RADIUS,
    SHRINK,
    SHRINK_AFTER_FAILURE,
    SMALLEST_RADIUS,
    TrustRegion,
)

EDGE, INSIDE = np.array([0.0, FIRST_RADIUS]), np.array([0.0, 0.1 * FIRST_RADIUS])
GOOD, FAILED = np.array([1.0]), np.array([np.inf])


@pytest.mark.parametrize(
    ("step", "objectives", "gain", "factor"),
    [
        (EDGE, GOOD, 0.9, GROW),
        (INSIDE, GOOD, 0.9, 1.0),
        (EDGE, GOOD, 0.3, 1.0),
        (EDGE, GOOD, 0.0, SHRINK),
        (EDGE, FAILED, 0.0, SHRINK_AFTER_FAILURE),
    ],
)
def test_good_steps_to_the_edge_widen_a_region_and_bad_ones_shrink_it(step, objectives, gain, factor) -> None:
    after = TrustRegion().after(step, objectives, gain, 1.0)
    assert after.radius == pytest.approx(factor * FIRST_RADIUS)


def test_only_failures_shrink_a_region_below_the_least_width_and_a_restart_widens_it() -> None:
    region = TrustRegion()
    for _ in range(30):
        region = region.after(EDGE, GOOD, 0.0, 1.0)
    assert region.radius == LEAST_RADIUS
    assert region.is_whole
    for _ in range(30):
        region = region.after(EDGE, FAILED, 0.0, 1.0)
    assert region.radius == SMALLEST_RADIUS
    assert not region.is_whole
    assert region.after(EDGE, GOOD, 0.0, 1.0) == region
    assert region.widened() == TrustRegion(LEAST_RADIUS)
    for _ in range(30):
        region = region.after(np.array([1.0]), GOOD, 1.0, 1.0)
    assert region == TrustRegion(1.0)


def test_a_phase_settles_after_rounds_in_vain_and_one_gain_begins_the_count_anew() -> None:
    phase = SearchPhase()
    for hope in (0.0, 2.0 * STAGNANT, *(STAGNANT_ROUNDS * [0.5 * STAGNANT])):
        assert not phase.has_settled
        phase.note(3.0 * hope, 3.0, 0.0, is_whole=True)
    assert phase.has_settled
    assert phase.n_idle == 0
    assert phase.gains_little(0.0, is_at_best=True, is_whole=True)
    # Away from the best simulation it has a round more.
    assert STAGNANT_ROUNDS_AWAY > STAGNANT_ROUNDS
    assert not phase.gains_little(0.0, is_at_best=False, is_whole=True)


@pytest.mark.parametrize(("outlying", "is_over"), [(0.0, True), (0.9, False)])
def test_what_a_phase_owes_is_measured_without_the_largest_samples(outlying: float, is_over: bool) -> None:
    lowest = np.linspace(1.0, 1.0 - 0.9 * STALL_GAIN, STALL_ROUNDS + 1).tolist()
    phase = SearchPhase(lowest=lowest)
    assert phase.gains_little(outlying, is_at_best=True, is_whole=True) is is_over


def test_many_small_gains_together_make_earlier_tests_count_no_more() -> None:
    def best(objective: float) -> Incumbent:
        return Incumbent(0, np.zeros(1), objective)

    known = Confirmation().after(best(1.0))
    known.note_test(np.zeros(3))
    assert known.after(best(1.0 - 0.6 * CONFIRMED)) is known
    assert not known.after(best(1.0 - 1.2 * CONFIRMED)).n_tested


def test_simulations_are_judged_by_the_window_and_failed_or_diverged_ones_teach_nothing() -> None:
    problem = rc_problem(noise=0.05)
    rows = Rows(problem, 0, 4)
    u = np.array([[0.2, 0.2], [0.6, 0.4], [0.9, 0.9], [0.5, 0.5]])
    r = problem.space.from_unit(u[[1]])[0, 0]
    answer = problem.on(FailsInBand(ToyRC(), 0.99 * r, 1.01 * r)).evaluate(u)
    rows.add(answer)
    np.testing.assert_allclose(rows.objective, answer.objective)
    assert rows.good.tolist() == rows.sane.tolist() == [True, False, True, True]
    best = rows.best()
    assert best.objective == rows.lowest() == answer.objective.min()
    assert rows.best(rows.n).row == rows.n - 1
    assert rows.lowest(rows.n) == np.inf
    rows.window.shorten()
    rows.judge_again()
    n = rows.window.seen(answer.residuals).shape[1]
    np.testing.assert_allclose(rows.objective[0], np.mean(answer.residuals[0, :n] ** 2))
    assert rows.n == 4
    rows.objective[2] = 2.0 * DIVERGED * rows.objective[[0, 3]].max()
    assert rows.sane.tolist() == [True, False, False, True]


def test_the_truth_leaves_nothing_unexplained() -> None:
    problem = rc_problem()
    rows = Rows(problem, 0, 1)
    rows.add(problem.evaluate(problem.space.to_unit(TRUE_RC)[None]))
    assert rows.unexplained == pytest.approx(0.0, abs=1e-20)
    assert not rows.switches
