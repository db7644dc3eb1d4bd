"""What every optimizer promises, on every toy problem."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from problems_for_tests import TRUE_RC, Diary, FailsInBand, problem_on, product_problem, rc_problem
from toy_rc import ToyRC

from simulation.errors import InputError
from studies.calibration.optimizers import SciPyMinimize, SurrogateSearch, optimizer_of
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem
from studies.calibration.recorder import Progress
from studies.calibration.screen import DifferentialEvolution

START = np.array([0.2, 0.9])
Optimizer = Callable[..., Any]


def _screen(problem: CalibrationProblem, *, seed: int = 0, max_calls: int | None = None, **more: Any) -> Any:
    settings = DifferentialEvolution(popsize=8, maxiter=150, tol=1e-8, max_calls=max_calls)
    return settings.minimize(problem, seed=seed, **more)


def _polish(settings: Any) -> Optimizer:
    def run(problem: CalibrationProblem, *, seed: int = 0, max_calls: int | None = 2000, **more: Any) -> Any:
        return replace(settings, max_calls=max_calls).minimize(problem, START, **more)

    return run


OPTIMIZERS: dict[str, Optimizer] = {
    "differential evolution": _screen,
    "LS-TRF": _polish(LeastSquaresTRF(ftol=1e-12)),
    "surrogate search": _polish(SurrogateSearch()),
    "COBYQA": _polish(SciPyMinimize(tol=1e-10)),
    "L-BFGS-B": _polish(SciPyMinimize("L-BFGS-B", tol=1e-10)),
    "LS-TRF squared": _polish(LeastSquaresTRF(ftol=1e-14, xtol=1e-12, residuals="squared")),
}
# With the largest error of the parameters that are sought: the noise, or next to nothing.
PROBLEMS: dict[str, tuple[Callable[[], CalibrationProblem], float]] = {
    "step response": (rc_problem, 1e-6),
    "product": (product_problem, 1e-6),
    "noisy step response": (lambda: rc_problem(noise=0.05), 0.05**2),
}
every_optimizer = pytest.mark.parametrize("optimize", OPTIMIZERS.values(), ids=OPTIMIZERS.keys())


@pytest.mark.parametrize(("pose", "largest"), PROBLEMS.values(), ids=PROBLEMS.keys())
@every_optimizer
def test_the_result_is_the_best_of_the_rows_that_were_asked_and_counted(
    optimize: Optimizer, pose: Callable[[], CalibrationProblem], largest: float
) -> None:
    problem, reports = pose(), list[Progress]()
    diary = Diary(problem.model)
    found = optimize(problem.on(diary), seed=3, on_progress=reports.append)
    history = found.history
    assert found.mse < largest
    assert found.n_calls == len(diary.rows) == history.n_calls[-1] == reports[-1].n_done
    assert reports[-1].n_total is not None
    assert reports[-1].n_done <= reports[-1].n_total
    assert problem.space.contains(diary.rows).all()
    all_mse = ((problem.model.simulate(diary.rows).y - problem.measurement.y) ** 2).mean(axis=(1, 2))
    assert found.mse == pytest.approx(all_mse.min(), rel=1e-12, abs=1e-25)
    np.testing.assert_array_equal(found.theta, diary.rows[np.argmin(all_mse)])
    np.testing.assert_allclose(found.y, problem.model.simulate(found.theta[None]).y[0])
    np.testing.assert_allclose(problem.space.from_unit(found.u), found.theta, rtol=1e-12)
    assert (np.diff(history.n_calls) > 0).all()
    assert (np.diff(history.best_mse) <= 0).all()
    assert history.best_mse[-1] == found.mse == reports[-1].best_mse
    assert history.calls_to(found.mse / 2.0) is None or found.mse == 0.0
    # It repeats itself bit for bit.
    again = optimize(pose(), seed=3)
    np.testing.assert_array_equal(again.u, found.u)
    np.testing.assert_array_equal(again.history.n_calls, history.n_calls)
    np.testing.assert_array_equal(again.history.best_mse, history.best_mse)


@pytest.mark.parametrize("max_calls", [17, 50])
@every_optimizer
def test_never_asks_beyond_its_budget_and_says_so(optimize: Optimizer, max_calls: int) -> None:
    problem = rc_problem(noise=0.05)
    diary = Diary(problem.model)
    found = optimize(problem.on(diary), max_calls=max_calls)
    assert found.n_calls == len(diary.rows) <= max_calls
    assert np.isfinite(found.mse)
    if not found.converged:
        n_left = max_calls - found.n_calls
        said = f"has only {n_left} left" if n_left else f"the budget of {max_calls} calls is spent"
        assert found.stop_reason.endswith(said)


@every_optimizer
def test_finds_the_optimum_beside_a_failed_region(optimize: Optimizer) -> None:
    problem = problem_on(ToyRC(), TRUE_RC).on(FailsInBand(ToyRC(), 2.0, 5.0))
    diary = Diary(problem.model)
    found = optimize(problem.on(diary))
    assert found.n_calls == len(diary.rows)
    assert found.mse < 1e-4


@every_optimizer
def test_ends_at_the_edge_when_the_optimum_cannot_be_simulated(optimize: Optimizer) -> None:
    problem = problem_on(ToyRC(), TRUE_RC).on(ToyRC(fails_above_r=1.2))
    found = optimize(problem)
    assert found.theta[0] == pytest.approx(1.2, rel=0.05)
    assert found.theta[0] <= 1.2
    assert found.stop_reason


@every_optimizer
def test_survives_when_every_row_fails(optimize: Optimizer) -> None:
    problem = rc_problem().on(ToyRC(fails_above_r=0.0))
    found = optimize(problem, max_calls=200)
    assert found.mse == np.inf
    assert not found.converged


@every_optimizer
def test_an_interruption_from_outside_passes_through(optimize: Optimizer) -> None:
    def interrupt(_: Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        optimize(rc_problem(), on_progress=interrupt)


def test_screening_leaves_the_margin_out_and_refuses_one_that_leaves_nothing() -> None:
    result = DifferentialEvolution(popsize=5, maxiter=5, margin=0.3).minimize(rc_problem(), seed=0)
    assert (result.population_u >= 0.3).all()
    assert (result.population_u <= 0.7).all()
    with pytest.raises(InputError, match=r"margin is 0\.5; give a value in \[0, 0\.5\)"):
        DifferentialEvolution(margin=0.5)


def test_a_profile_names_the_optimizer_and_its_arguments() -> None:
    usual = optimizer_of({"name": "LeastSquaresTRF"}, max_calls=7, ftol=1e-3)
    assert usual == LeastSquaresTRF(max_calls=7, ftol=1e-3)
    # What all polishes have counts as far as the optimizer has it.
    other = optimizer_of({"name": "SciPyMinimize", "method": "Powell"}, max_calls=7, ftol=1e-3)
    assert other == SciPyMinimize("Powell", max_calls=7)
    with pytest.raises(InputError, match=r"^polish\.optimizer: name = 'Adam' is none of SurrogateSearch, "):
        optimizer_of({"name": "Adam"})
    with pytest.raises(InputError, match=r"^polish\.optimizer: SciPyMinimize has no argument 'metod'"):
        optimizer_of({"name": "SciPyMinimize", "metod": "Powell"})
    with pytest.raises(InputError, match=r"^polish\.optimizer: method = 'BFGS' is none of COBYQA, "):
        optimizer_of({"name": "SciPyMinimize", "method": "BFGS"})
