"""A polish that a surrogate leaders: what it saves, whose errors it finds out, and what it repeats."""

import numpy as np
import pytest
from problems_for_tests import TRUE_RC, Diary, FailsInBand, rc_problem
from toy_rc import ToyRC

from simulation.arrays import FloatArray
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.trajectories import Trajectories
from studies.calibration.corrected_surrogate import LEAST_SHARE, CorrectedSurrogate
from studies.calibration.optimizers import SurrogateSearch
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import SearchResult

N_TRAIN = 8
# The surrogate's heater is 10 % too weak: its optimum is not the model's.
BIASED = ToyRC(heat_flow=9.0)


class Memorized(WrappedModel):
    """A surrogate that is right at its training rows and mirrors the box between them."""

    def __init__(self, model: ForwardModel, training: FloatArray) -> None:
        super().__init__(model)
        self._training = training

    def simulate(self, theta: FloatArray) -> Trajectories:
        is_known = (theta[:, None] == self._training[None]).all(axis=2).any(axis=1)
        mirrored = self.parameter_space.from_unit(1.0 - self.parameter_space.to_unit(theta))
        return self._model.simulate(np.where(is_known[:, None], theta, mirrored))


def training_rows(problem: CalibrationProblem) -> Evaluation:
    return problem.evaluate(np.random.default_rng(5).random((N_TRAIN, 2)))


def polish(problem: CalibrationProblem, surrogate: ForwardModel, *, max_calls: int = 60) -> SearchResult:
    """Polish the surrogate's optimum, from which the training rows are known."""
    cheap = problem.on(surrogate)
    screened = LeastSquaresTRF().minimize(cheap, np.array([0.5, 0.5])).u
    known = training_rows(problem).joined(problem.evaluate(screened))
    settings = SurrogateSearch(max_calls=max_calls)
    return settings.minimize(problem, screened, known=known, surrogate=cheap, seed=1)


def test_a_biased_surrogate_leads_the_search_to_the_optimum_of_the_model_in_fewer_calls() -> None:
    problem = rc_problem(noise=0.05)
    diary = Diary(problem.model)
    found = polish(problem.on(diary), BIASED)
    screened = LeastSquaresTRF().minimize(problem.on(BIASED), np.array([0.5, 0.5])).u
    least = LeastSquaresTRF().minimize(problem, screened)
    n_known = N_TRAIN + 1
    assert found.n_calls == len(diary.rows) - n_known == found.history.n_calls[-1]
    np.testing.assert_allclose(found.theta, TRUE_RC, rtol=0.02)
    assert found.mse <= 1.001 * least.mse
    ours, theirs = (one.history.calls_to(1.02 * least.mse) for one in (found, least))
    assert ours is not None
    assert theirs is not None
    assert ours <= theirs / 2


def test_it_converges_by_itself_and_repeats_itself() -> None:
    first, again = (polish(rc_problem(noise=0.05), BIASED) for _ in range(2))
    assert first.converged
    np.testing.assert_array_equal(first.history.best_mse, again.history.best_mse)
    np.testing.assert_array_equal(first.u, again.u)


def test_a_surrogate_that_knows_its_training_rows_alone_is_left_once_others_show_it() -> None:
    problem = rc_problem(noise=0.05)
    training = training_rows(problem)
    leader = CorrectedSurrogate(problem.on(Memorized(ToyRC(), training.theta)), seed=0)
    leader.note(training)
    assert leader.propose(1) is not None, "training rows say nothing against it"
    leader.note(problem.evaluate(np.random.default_rng(6).random((4, 2))))
    assert leader.propose(1) is None
    assert leader.share < LEAST_SHARE


def test_a_surrogate_that_is_right_at_new_rows_keeps_its_share() -> None:
    problem = rc_problem(noise=0.05)
    leader = CorrectedSurrogate(problem.on(BIASED), seed=0)
    leader.note(training_rows(problem))
    assert leader.propose(1) is not None
    leader.note(problem.evaluate(np.random.default_rng(6).random((4, 2))))
    assert leader.propose(1) is not None
    assert leader.share > 0.8


def test_rows_that_fail_cost_a_call_and_do_not_end_it() -> None:
    problem = rc_problem(noise=0.05)
    model = FailsInBand(ToyRC(), 1.75, 3.0)
    found = polish(problem.on(model), BIASED)
    assert model.n_failed
    np.testing.assert_allclose(found.theta, TRUE_RC, rtol=0.02)


@pytest.mark.parametrize("max_calls", [1, 5])
def test_it_keeps_its_limit_of_calls(max_calls: int) -> None:
    problem = rc_problem(noise=0.05)
    diary = Diary(problem.model)
    found = polish(problem.on(diary), BIASED, max_calls=max_calls)
    assert found.n_calls == len(diary.rows) - N_TRAIN - 1 == max_calls
    assert not found.converged
