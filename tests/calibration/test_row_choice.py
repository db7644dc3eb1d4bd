"""Calibrations that start from stored rows (warm start)."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measurement_for_tests import with_samples
from problems_for_tests import TRUE_RC, Diary, rc_problem

from simulation.arrays import FloatArray
from simulation.case import load_case
from simulation.errors import InputError
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.search.adaptive import Adaptive
from studies.calibration.search.row_choice import N_BEST, N_FAR, SAME_ROW, best_and_far

SHORT = Adaptive(max_calls=60)
REPOSITORY = Path(__file__).parents[2]


def with_other_data(problem: CalibrationProblem) -> CalibrationProblem:
    """The same model measured anew: what was measured before was a tenth too low."""
    measurement = problem.measurement
    samples = [replace(one.samples, values=1.1 * one.samples.values) for one in measurement.outputs]
    return replace(problem, measurement=with_samples(measurement, samples))


def rows_of(problem: CalibrationProblem, seed: int) -> FloatArray:
    """The rows that a calibration from nothing asks."""
    diary = Diary(problem.model)
    Adaptive(max_calls=20).minimize(problem.on(diary), seed=seed)
    return problem.space.to_unit(diary.rows)


def evaluated(problem: CalibrationProblem, n: int, seed: int | list[int] = 0) -> Evaluation:
    return problem.evaluate(np.random.default_rng(seed).random((n, problem.space.n_parameters)))


def test_a_calibration_to_changed_data_costs_a_few_calls() -> None:
    seed = 0
    problem = rc_problem(noise=0.05)
    other = with_other_data(problem)
    target = 1.02 * LeastSquaresTRF().minimize(other, other.space.to_unit(TRUE_RC)).mse
    anew = replace(SHORT, target_mse=target).minimize(other, seed=seed)
    known = other.evaluate(rows_of(problem, seed))
    warm = Adaptive(max_calls=3, target_mse=target).minimize(other, seed=seed, known=known)
    assert anew.converged
    assert warm.converged
    assert anew.n_calls > 3 * warm.n_calls


def test_a_first_design_may_lack_one_row() -> None:
    """Three of four rows are known; a design of one row had no distances, and the search crashed."""
    known = rc_problem(noise=0.05).evaluate(np.array([[0.1, 0.1], [0.5, 0.9], [0.9, 0.5]]))
    found = Adaptive(max_calls=2).minimize(rc_problem(noise=0.05), seed=0, known=known)
    assert found.n_calls == 2


def test_a_warm_start_costs_no_calls_and_the_first_entry_of_the_history() -> None:
    problem = rc_problem(noise=0.05)
    known = evaluated(problem, 20)
    diary = Diary(problem.model)
    found = Adaptive(max_calls=5).minimize(problem.on(diary), seed=0, known=known)
    assert found.n_calls == len(diary.rows) == found.history.n_calls[-1]
    assert found.history.n_calls[0] == 0
    assert found.history.best_mse[0] == known.mse.min()
    # They are a design: from the first call on a single row is asked.
    assert len(diary.batches[0]) == 1


def test_rows_of_one_spot_are_no_design() -> None:
    problem = rc_problem(noise=0.05)
    spot = problem.space.to_unit(TRUE_RC * 1.5)
    known = problem.evaluate(spot + 0.01 * np.random.default_rng(0).random((20, 2)))
    diary = Diary(problem.model)
    Adaptive(max_calls=10).minimize(problem.on(diary), seed=0, known=known)
    assert len(diary.batches[0]) == SHORT.design_size(2) - 1


def test_a_target_that_a_known_row_has_reached_costs_nothing() -> None:
    problem = rc_problem(noise=0.05)
    known = evaluated(problem, 30)
    best = int(np.argmin(known.mse))
    found = replace(SHORT, target_mse=1.01 * known.mse[best]).minimize(problem, seed=0, known=known)
    assert found.n_calls == found.n_rounds == 0
    assert found.converged
    np.testing.assert_array_equal(found.theta, known.theta[best])
    np.testing.assert_array_equal(found.y, known.y[best])


def test_rows_of_another_problem_are_refused() -> None:
    problem = rc_problem()
    known = evaluated(problem, 5)
    for other in (replace(known, residuals=known.residuals[:, 1:]), known.theta):
        with pytest.raises(InputError, match="of the same problem: 2 parameters and 25 residuals"):
            SHORT.minimize(problem, seed=0, known=other)  # type: ignore[arg-type]


def test_the_best_rows_come_first_then_the_farthest_and_none_twice() -> None:
    rng = np.random.default_rng(0)
    near, far = 0.5 + 0.1 * rng.random((N_BEST + 300, 3)), np.array([[0.0, 0.0, 1.0], [1.0, 1.0, 0.0]])
    u = np.concatenate([near, near[:50] + 0.1 * SAME_ROW, far])
    worth = -np.linalg.norm(u - 0.55, axis=1)
    worth[0] = -np.inf
    rows = best_and_far(u, worth)
    assert len(rows) == len(set(rows)) == N_BEST + N_FAR
    assert 0 not in rows
    assert (np.diff(worth[rows[:N_BEST]]) <= 0.0).all()
    assert set(rows[N_BEST : N_BEST + 2]) == {len(u) - 2, len(u) - 1}
    gaps = np.abs(u[rows][:, None] - u[rows]).max(axis=2) + np.eye(len(rows))
    assert gaps.min() > SAME_ROW


def test_a_few_new_rows_count_beside_many_known_ones() -> None:
    # All over the box an oscillator's rows pass for noise; were those beside the best one to, too, the least
    # error of these three would be ten times that of the known ones.
    case = load_case(REPOSITORY / "fmus" / "vanderpol" / "case.toml")
    with case.open_model() as model:
        problem = CalibrationProblem(model, case.measurement)
        training = evaluated(problem, 256, [3, 2])
        known = problem.evaluate(training.u[best_and_far(training.u, -training.objective)])
        found = Adaptive(max_calls=3).minimize(problem, seed=3, known=known)
    assert found.mse < 0.5 * known.mse.min()
