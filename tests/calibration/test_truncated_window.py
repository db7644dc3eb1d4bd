"""The window of an adaptive calibration: what is seen, what counts as explained, and a frequency found."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from measurement_for_tests import with_each
from problems_for_tests import problem_on

from simulation.arrays import FloatArray
from simulation.parameters import Parameter, ParameterSpace
from simulation.robust_loss import RobustLoss
from simulation.trajectories import Trajectories
from studies.calibration.problem import CalibrationProblem
from studies.calibration.search.adaptive import Adaptive
from studies.calibration.search.truncated_window import SHORTEST, TruncatedWindow

TRUE_WAVE = np.array([3.3, 0.7])


@dataclass(frozen=True)
class Wave:
    """Thirty periods of a sine: its error over the frequency has a valley per period."""

    parameter_space: ParameterSpace = field(
        default_factory=lambda: ParameterSpace(
            (Parameter("frequency", 1.0, 6.0), Parameter("amplitude", 0.2, 2.0))
        )
    )
    output_names: tuple[str, ...] = ("wave",)
    time: FloatArray = field(default_factory=lambda: np.linspace(0.0, 60.0, 400))

    def simulate(self, theta: FloatArray) -> Trajectories:
        return Trajectories.checked(
            theta,
            (theta[:, 1:] * np.sin(theta[:, :1] * self.time))[:, :, None],
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
        )


def wave_problem() -> CalibrationProblem:
    return problem_on(Wave(), TRUE_WAVE, noise=0.02)


def test_all_is_seen_at_first_and_the_beginning_after_shortening() -> None:
    window = TruncatedWindow(wave_problem().measurement)
    residuals = np.arange(800.0).reshape(2, 400)
    np.testing.assert_array_equal(window.seen(residuals), residuals)
    window.shorten()
    np.testing.assert_array_equal(window.seen(residuals), residuals[:, : int(np.ceil(400 * SHORTEST))])
    n_seen = []
    while not window.is_whole:
        window.double()
        n_seen.append(window.seen(residuals).shape[1])
    assert n_seen == [25, 50, 100, 200, 400]


def test_a_flat_line_at_the_mean_explains_nothing() -> None:
    problem = wave_problem()
    measured = problem.measurement.y[:, 0]
    window = TruncatedWindow(problem.measurement)
    assert window.unexplained(measured.mean() - measured) == pytest.approx(1.0)
    assert window.unexplained(0.1 * (measured.mean() - measured)) == pytest.approx(0.01)


def test_finds_a_frequency_among_its_many_valleys() -> None:
    problem = wave_problem()
    best = problem.mse(problem.space.to_unit(TRUE_WAVE))[0]
    ends = [Adaptive(max_calls=60).minimize(problem, seed=seed) for seed in range(2)]
    assert all(found.mse <= 1.1 * best for found in ends), [found.mse / best for found in ends]


def test_a_truncated_window_repeats_too() -> None:
    long, short = (
        Adaptive(max_calls=n, n_parallel=3, ftol=0.0).minimize(wave_problem(), seed=1) for n in (30, 18)
    )
    n = short.history.best_mse.size - 1
    np.testing.assert_array_equal(long.history.best_mse[:n], short.history.best_mse[:n])


def test_features_are_those_of_the_simulation_whatever_the_loss() -> None:
    problem = wave_problem()
    robust = with_each(problem.measurement, loss=RobustLoss("huber", 0.05))
    y = problem.evaluate(np.array([0.2, 0.8])).y
    found = []
    for measurement in (problem.measurement, robust):
        window, residuals = TruncatedWindow(measurement), measurement.compared(y)
        window.shorten(to_features=True)
        found.append([*window.seen(residuals)[0], window.unexplained(residuals[0])])
    np.testing.assert_allclose(found[0], found[1], rtol=1e-9)
