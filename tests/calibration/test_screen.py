"""Differential evolution: the traps of its vectorized form, its population, its ends."""

import numpy as np
import pytest
from problems_for_tests import Diary, product_problem, rc_problem
from toy_rc import ToyRC

from simulation.errors import InputError
from studies.calibration.recorder import Progress
from studies.calibration.screen import DifferentialEvolution


def test_a_generation_is_one_batch_of_rows_not_columns() -> None:
    problem = rc_problem()
    diary = Diary(problem.model)
    result = DifferentialEvolution(popsize=8, maxiter=5, tol=0.0).minimize(problem.on(diary), seed=0)
    assert [batch.shape for batch in diary.batches] == [(16, 2)] * 6
    assert result.n_calls == 96


def test_there_is_no_hidden_polish_after_the_last_generation() -> None:
    problem = rc_problem()
    diary = Diary(problem.model)
    result = DifferentialEvolution(popsize=8, maxiter=500).minimize(problem.on(diary), seed=0)
    assert result.converged
    assert {len(batch) for batch in diary.batches} == {16}


def test_other_seeds_search_otherwise_and_find_the_same() -> None:
    settings = DifferentialEvolution(maxiter=150, tol=1e-8)
    first, second = (settings.minimize(rc_problem(), seed=seed) for seed in (0, 1))
    assert not np.array_equal(first.history.best_mse[:5], second.history.best_mse[:5])
    np.testing.assert_allclose(first.theta, second.theta, rtol=1e-2)


def test_the_population_is_sorted_and_its_errors_are_true() -> None:
    problem = product_problem()
    result = DifferentialEvolution(maxiter=10).minimize(problem, seed=0)
    errors = problem.mse(result.population_u)
    assert (np.diff(errors) >= 0).all()
    assert errors[0] == pytest.approx(result.mse, rel=1e-12)


def test_the_first_population_counts_when_no_generation_follows() -> None:
    result = DifferentialEvolution(maxiter=0).minimize(rc_problem(), seed=0)
    assert result.n_calls == len(result.population_u) == 16
    assert not result.converged


def test_a_half_failing_box_is_searched_without_a_warning() -> None:
    result = DifferentialEvolution(maxiter=100).minimize(rc_problem().on(ToyRC(fails_above_r=2.0)), seed=0)
    assert result.mse < 1e-3


def test_progress_knows_the_end() -> None:
    reports: list[Progress] = []
    DifferentialEvolution(maxiter=5, tol=0.0).minimize(rc_problem(), seed=0, on_progress=reports.append)
    assert [report.n_done for report in reports] == [16, 32, 48, 64, 80, 96]
    assert {report.n_total for report in reports} == {96}
    assert {report.phase for report in reports} == {"screen"}


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"popsize": 0}, "popsize is 0"), ({"maxiter": -1}, "maxiter -1"), ({"max_calls": 5}, "has 16 rows")],
)
def test_useless_settings_are_refused(settings: dict[str, int], message: str) -> None:
    with pytest.raises(InputError, match=message):
        DifferentialEvolution(**settings).minimize(rc_problem(), seed=0)  # type: ignore[arg-type]
