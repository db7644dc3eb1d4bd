"""The paper's method: what is counted, what is returned, and a screened point that fails."""

import numpy as np
import pytest
from problems_for_tests import TRUE_RC, Diary, FailsInBand, rc_problem
from toy_rc import ToyRC

from simulation.forward_model import ForwardModel
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.screen import DifferentialEvolution
from studies.calibration.two_phase import TwoPhaseResult, calibrate_two_phase

SCREENING = DifferentialEvolution(maxiter=60)
WRONG = ToyRC(heat_flow=11.5)


def calibrate(surrogate: ForwardModel, physical: ForwardModel, **changes: object) -> TwoPhaseResult:
    arguments: dict[str, object] = {
        "screening": SCREENING,
        "polishing": LeastSquaresTRF(),
        "seed": 0,
        "n_train": 32,
        "n_validation": 320,
        "n_test": 320,
    }
    return calibrate_two_phase(
        surrogate,
        physical,
        rc_problem(noise=0.05).measurement,
        **(arguments | changes),  # type: ignore[arg-type]
    )


def test_every_row_asked_of_the_physical_model_is_in_the_ledger() -> None:
    diary = Diary(ToyRC())
    result = calibrate(WRONG, diary)
    assert result.ledger.n_screen_checks == 1
    assert result.ledger.n_screen_checks + result.ledger.n_polish == len(diary.rows)
    assert result.ledger.total_paper == 32 + len(diary.rows)
    assert result.ledger.total_calls == 672 + len(diary.rows)


def test_the_polish_repairs_what_the_surrogate_did_not_see() -> None:
    result = calibrate(WRONG, ToyRC())
    problem = rc_problem(noise=0.05)
    np.testing.assert_allclose(result.polish.theta, TRUE_RC, rtol=0.02)
    assert result.polish.mse < 0.1 * result.screened.mse[0]
    assert problem.mse(result.polish.u)[0] == pytest.approx(result.polish.mse)
    assert problem.mse(result.screened.u)[0] == pytest.approx(result.screened.mse[0])
    assert problem.on(WRONG).mse(result.screened.u)[0] == pytest.approx(result.mse_surrogate)
    np.testing.assert_allclose(result.polish.y, ToyRC().simulate(result.polish.theta[None]).y[0])
    np.testing.assert_allclose(result.screened.y[0], ToyRC().simulate(result.screened.theta).y[0])


def test_calls_to_a_target_include_training_and_the_screening_check() -> None:
    result = calibrate(WRONG, ToyRC())
    assert result.history.n_calls[0] == 33
    assert result.history.best_mse[0] == result.screened.mse[0]
    assert result.history.calls_to(result.screened.mse[0]) == 33
    reached = result.history.calls_to(result.polish.mse)
    assert reached is not None
    assert 33 < reached <= result.ledger.total_paper
    assert result.history.calls_to(0.5 * result.polish.mse) is None


def test_a_screened_point_that_fails_gives_way_to_another() -> None:
    broad = DifferentialEvolution(popsize=32, maxiter=3)
    screened = calibrate(ToyRC(), ToyRC(), screening=broad).screened.theta[0, 0]
    diary = Diary(FailsInBand(ToyRC(), 0.98 * screened, 1.02 * screened))
    result = calibrate(ToyRC(), diary, screening=broad)
    assert 1 < result.ledger.n_screen_checks <= 5
    assert np.isfinite(result.screened.mse[0])
    assert result.screened.theta[0, 0] != screened
    assert result.ledger.n_screen_checks + result.ledger.n_polish == len(diary.rows)
    assert result.history.n_calls[0] == 32 + result.ledger.n_screen_checks


def test_a_physical_model_that_never_answers_is_a_result_not_an_error() -> None:
    result = calibrate(ToyRC(), ToyRC(fails_above_r=0.0))
    assert result.polish.mse == np.inf
    assert "cannot be simulated" in result.polish.stop_reason
