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


def test_the_polish_repairs_what_the_surrogate_did_not_see_and_all_calls_are_in_the_ledger() -> None:
    diary = Diary(ToyRC())
    result = calibrate(WRONG, diary)
    ledger, polish, screened = result.ledger, result.polish, result.screened
    assert ledger.n_screen_checks == 1
    assert ledger.n_screen_checks + ledger.n_polish == len(diary.rows)
    assert ledger.total_paper == 32 + len(diary.rows)
    assert ledger.total_calls == 672 + len(diary.rows)

    problem = rc_problem(noise=0.05)
    np.testing.assert_allclose(polish.theta, TRUE_RC, rtol=0.02)
    assert polish.mse < 0.1 * screened.mse[0]
    assert problem.mse(polish.u)[0] == pytest.approx(polish.mse)
    assert problem.mse(screened.u)[0] == pytest.approx(screened.mse[0])
    assert problem.on(WRONG).mse(screened.u)[0] == pytest.approx(result.mse_surrogate)
    np.testing.assert_allclose(polish.y, ToyRC().simulate(polish.theta[None]).y[0])
    np.testing.assert_allclose(screened.y[0], ToyRC().simulate(screened.theta).y[0])

    # Calls to a target include training and the check of the screening.
    history = result.history
    assert (history.n_calls[0], history.best_mse[0]) == (33, screened.mse[0])
    assert history.calls_to(screened.mse[0]) == 33
    reached = history.calls_to(polish.mse)
    assert reached is not None
    assert 33 < reached <= ledger.total_paper
    assert history.calls_to(0.5 * polish.mse) is None


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
