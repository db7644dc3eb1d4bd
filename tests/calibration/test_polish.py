"""LS-TRF: what an iteration costs, starts on bounds, failures beside the start, the paper's variant."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems_for_tests import TRUE_RC, Diary, FailsInBand, product_problem, rc_problem
from scipy.optimize import least_squares
from toy_rc import ToyRC

from simulation.errors import InputError
from studies.calibration.polish import LeastSquaresTRF

START = np.array([0.2, 0.9])


def test_an_iteration_is_one_trial_point_and_one_batch_of_p_differences() -> None:
    problem = rc_problem()
    diary = Diary(problem.model)
    LeastSquaresTRF().minimize(problem.on(diary), START)
    assert [len(batch) for batch in diary.batches[:6]] == [1, 2, 1, 2, 1, 2]


def test_a_known_start_is_not_simulated_again() -> None:
    problem = rc_problem()
    known = problem.evaluate(START)
    diary = Diary(problem.model)
    informed = LeastSquaresTRF().minimize(problem.on(diary), START, known=known)
    asked = LeastSquaresTRF().minimize(problem, START)
    assert len(diary.batches[0]) == 2
    assert informed.n_calls == asked.n_calls - 1
    assert (informed.history.n_calls[0], informed.history.best_mse[0]) == (0, known.mse[0])
    np.testing.assert_array_equal(informed.u, asked.u)


def test_agrees_with_scipy_on_its_own() -> None:
    problem = rc_problem(noise=0.05)
    ours = LeastSquaresTRF(ftol=1e-12).minimize(problem, START)
    scipys = least_squares(lambda u: problem.residuals(u)[0], START, bounds=(0.0, 1.0), x_scale="jac")
    np.testing.assert_allclose(ours.u, scipys.x, atol=1e-6)
    assert ours.mse == pytest.approx(2.0 * scipys.cost / problem.measurement.y.size, rel=1e-9)


@pytest.mark.parametrize("corner", [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (-0.2, 1.7)])
def test_starts_on_and_beyond_the_bounds(corner: tuple[float, float]) -> None:
    problem = rc_problem()
    diary = Diary(problem.model)
    found = LeastSquaresTRF().minimize(problem.on(diary), np.array(corner))
    assert problem.space.contains(diary.rows).all()
    np.testing.assert_allclose(found.theta, TRUE_RC, rtol=1e-3)


@settings(max_examples=25, deadline=None)
@given(u=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)))
def test_never_returns_worse_than_its_start(u: tuple[float, float]) -> None:
    problem = product_problem()
    start = np.array(u)
    assert LeastSquaresTRF(max_calls=60).minimize(problem, start).mse <= problem.mse(start)[0]


def test_a_difference_that_fails_is_taken_to_the_other_side() -> None:
    # The start lies 1e-6 below the failing band, inside one difference step of it.
    problem = rc_problem()
    edge = problem.space.from_unit(START + np.array([1e-6, 0.0]))[0]
    diary = Diary(FailsInBand(ToyRC(), edge, 1.02 * edge))
    found = LeastSquaresTRF().minimize(problem.on(diary), START)
    assert [len(batch) for batch in diary.batches[:3]] == [1, 2, 1]
    assert found.n_calls == len(diary.rows)
    np.testing.assert_allclose(found.theta, TRUE_RC, rtol=1e-3)


def test_a_parameter_that_fails_on_both_sides_stays_for_the_iteration() -> None:
    # Any other R than the first fails; C goes on alone until it is the best for this R.
    problem = rc_problem()
    start_r = problem.space.from_unit(START)[0]
    diary = Diary(FailsInBand(FailsInBand(ToyRC(), 0.0, start_r * (1 - 1e-9)), start_r * (1 + 1e-9), 9.0))
    found = LeastSquaresTRF().minimize(problem.on(diary), START)
    assert found.theta[0] == pytest.approx(start_r, rel=1e-9)
    assert found.n_calls == len(diary.rows)
    only_c = np.column_stack([np.full(2001, START[0]), np.linspace(0.0, 1.0, 2001)])
    assert found.mse == pytest.approx(problem.mse(only_c).min(), rel=1e-3)


def test_a_start_that_cannot_be_simulated_is_reported_not_raised() -> None:
    found = LeastSquaresTRF().minimize(rc_problem().on(ToyRC(fails_above_r=0.3)), START)
    assert found.mse == np.inf
    assert found.n_calls == 1
    assert found.stop_reason.startswith("the starting point cannot be simulated: R = 0.38")


def test_squared_residuals_are_the_papers_fourth_powers() -> None:
    problem = rc_problem(noise=0.3)
    fourth = LeastSquaresTRF(ftol=1e-14, xtol=1e-12, residuals="squared").minimize(problem, START)
    reference = least_squares(
        lambda u: problem.residuals(u)[0] ** 2, START, bounds=(0.0, 1.0), ftol=1e-14, xtol=1e-12
    )
    signed = LeastSquaresTRF(ftol=1e-12).minimize(problem, START)
    power = (problem.residuals(reference.x) ** 4).mean()
    assert (problem.residuals(signed.u) ** 4).mean() > power
    assert signed.mse < problem.mse(reference.x)[0]
    assert fourth.mse >= signed.mse


def test_a_budget_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match="max_calls is 0"):
        LeastSquaresTRF(max_calls=0)
