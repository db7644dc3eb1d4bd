"""Differential evolution: the traps of its vectorized form, its population, its ends."""

import pytest
from problems_for_tests import Diary, rc_problem

from simulation.errors import InputError
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


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"popsize": 0}, "popsize is 0"), ({"maxiter": -1}, "maxiter -1"), ({"max_calls": 5}, "has 16 rows")],
)
def test_useless_settings_are_refused(settings: dict[str, int], message: str) -> None:
    with pytest.raises(InputError, match=message):
        DifferentialEvolution(**settings).minimize(rc_problem(), seed=0)  # type: ignore[arg-type]
