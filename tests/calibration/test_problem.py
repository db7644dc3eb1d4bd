"""Residuals and errors: signs, failures, and what cannot be compared."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from measurement_for_tests import with_each
from problems_for_tests import TRUE_RC, Waves, rc_problem
from toy_rc import ToyRC

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.forward_model import WrappedModel
from simulation.measurement import Measurement
from simulation.trajectories import Trajectories
from studies.calibration.problem import CalibrationProblem


def test_residuals_are_simulated_minus_measured() -> None:
    problem = rc_problem()
    warmer = problem.space.to_unit(TRUE_RC * np.array([1.2, 1.0]))
    residuals = problem.residuals(warmer)
    expected = (
        ToyRC().simulate((TRUE_RC * np.array([1.2, 1.0]))[None]).y[0, :, 0] - problem.measurement.y[:, 0]
    )
    np.testing.assert_allclose(residuals, expected[None], atol=1e-9)
    assert residuals[0, 1:].min() > 0.0


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(1, 6))
def test_rows_are_judged_independently(seed: int, n: int) -> None:
    problem = rc_problem(noise=0.1)
    rng = np.random.default_rng(seed)
    u = rng.random((n, 2))
    order = rng.permutation(n)
    np.testing.assert_array_equal(problem.mse(u)[order], problem.mse(u[order]))


def test_a_failed_row_is_infinitely_wrong_and_says_why() -> None:
    problem = rc_problem().on(ToyRC(fails_above_r=2.0))
    evaluation = problem.evaluate(problem.space.to_unit(np.array([[1.0, 1e4], [3.0, 1e4]])))
    assert np.isfinite(evaluation.mse[0])
    assert evaluation.mse[1] == np.inf
    assert evaluation.failures[0] == ""
    assert "R = 3" in evaluation.failures[1]
    assert np.isnan(evaluation.residuals[1]).all()


class TooLarge(WrappedModel):
    """A model whose values are finite, and their squares not."""

    def simulate(self, theta: FloatArray) -> Trajectories:
        answer = self._model.simulate(theta)
        return replace(answer, y=np.where(theta[:, :1, None] > 2.0, 1e200, answer.y))


def test_values_too_large_to_square_are_a_failure_with_words() -> None:
    problem = rc_problem()
    answer = problem.on(TooLarge(problem.model)).evaluate(np.array([[0.1, 0.5], [0.9, 0.5]]))
    assert answer.failures == ("", "the simulated values are not finite, or too large to square")
    assert np.isfinite(answer.mse[0])
    assert answer.mse[1] == np.inf


def test_another_model_with_other_parameters_is_refused() -> None:
    with pytest.raises(InputError, match="do not share parameters"):
        rc_problem().on(Waves())


PLAIN = rc_problem().measurement


@pytest.mark.parametrize(
    ("measurement", "message"),
    [
        (with_each(PLAIN, name="TAir"), r"outputs \('T',\) are not the measured ones \('TAir',\)"),
        (replace(PLAIN, time=np.arange(25) * 7200.0), "up to 86400 s, the measurement has 25 up to 172800 s"),
    ],
)
def test_a_measurement_that_cannot_be_compared_is_refused(measurement: Measurement, message: str) -> None:
    with pytest.raises(InputError, match=message):
        CalibrationProblem(ToyRC(), measurement)
