"""Priors: the closed form of a linear model, every solver, exact derivatives, and no change without one."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from measurement_for_tests import with_each
from problems_for_tests import problem_on, rc_problem

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.measurement import Measurement
from simulation.parameters import Belief, Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.prior import Prior, independent_samples
from studies.calibration.problem import CalibrationProblem
from studies.calibration.screen import DifferentialEvolution
from studies.calibration.search.adaptive import Adaptive
from studies.calibration.two_phase import calibrate_two_phase

BELIEFS = (Belief(0.4, 0.05), None, Belief(-0.3, 0.3))
SENSOR = 0.5
TIME = np.arange(12.0)


@dataclass(frozen=True)
class Line:
    """Three linear parameters: a polynomial in time."""

    beliefs: tuple[Belief | None, ...] = BELIEFS
    output_names: tuple[str, ...] = ("y",)
    time: FloatArray = field(default_factory=TIME.copy)

    @property
    def parameter_space(self) -> ParameterSpace:
        return ParameterSpace(
            tuple(Parameter(f"p{i}", -2.0, 2.0, prior=one) for i, one in enumerate(self.beliefs))
        )

    def simulate(self, theta: FloatArray) -> Trajectories:
        return Trajectories.checked(
            theta,
            (theta @ columns().T)[:, :, None],
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
        )


def columns() -> FloatArray:
    s = TIME / TIME[-1]
    return np.column_stack([np.ones_like(s), s, s**2])


def line_problem(beliefs: tuple[Belief | None, ...] = BELIEFS) -> CalibrationProblem:
    model = Line(beliefs)
    posed = problem_on(model, np.array([0.9, -0.4, 0.5]), noise=0.3, uncertainty=np.array([SENSOR]))
    return replace(posed, prior=Prior.of(model.parameter_space, posed.measurement))


def closed_form() -> FloatArray:
    """The most probable parameters of a linear model with normal noise and normal priors."""
    a = columns() / SENSOR
    held = np.diag([1.0 / one.deviation**2 if one else 0.0 for one in BELIEFS])
    centre = np.array([one.centre if one else 0.0 for one in BELIEFS])
    measured = line_problem().measurement.y[:, 0] / SENSOR
    solution: FloatArray = np.linalg.solve(a.T @ a + held, a.T @ measured + held @ centre)
    return solution


def by_trf(problem: CalibrationProblem) -> FloatArray:
    return LeastSquaresTRF(ftol=1e-12).minimize(problem, np.full(3, 0.4)).theta


def by_evolution(problem: CalibrationProblem) -> FloatArray:
    return DifferentialEvolution(maxiter=120, tol=1e-8).minimize(problem, seed=1).theta


def by_adaptive(problem: CalibrationProblem) -> FloatArray:
    return Adaptive(max_calls=30, ftol=1e-6).minimize(problem, seed=1).theta


def by_two_phases(problem: CalibrationProblem) -> FloatArray:
    return calibrate_two_phase(
        problem.model,
        problem.model,
        problem.measurement,
        screening=DifferentialEvolution(maxiter=5),
        polishing=LeastSquaresTRF(),
        seed=1,
        n_train=0,
        prior=problem.prior,
    ).polish.theta


SOLVERS: tuple[Callable[[CalibrationProblem], FloatArray], ...] = (
    by_trf,
    by_evolution,
    by_adaptive,
    by_two_phases,
)


@pytest.mark.parametrize("solve", SOLVERS)
def test_every_solver_finds_the_closed_form(solve: Callable[[CalibrationProblem], FloatArray]) -> None:
    most_probable = closed_form()
    without = np.linalg.lstsq(columns(), line_problem().measurement.y[:, 0], rcond=None)[0]
    assert np.abs(most_probable - without).max() > 0.1, "the prior must matter here"
    # The adaptive search rounds coordinates to 1e-5 of the range of 4; evolution stops at its tolerance.
    np.testing.assert_allclose(solve(line_problem()), most_probable, atol=1e-3)


def logarithmic(factor: float, centre: float = 0.5) -> CalibrationProblem:
    """R and C with noise, R with a prior around another value."""
    posed = rc_problem(noise=0.2)
    r, c = posed.space.parameters
    space = ParameterSpace((replace(r, prior=Belief(centre, factor)), c))
    return replace(posed, prior=Prior.of(space, posed.measurement))


def test_a_narrow_prior_holds_its_parameter_and_the_mse_stays_the_data_s() -> None:
    held = LeastSquaresTRF().minimize(logarithmic(1.0001), np.array([0.3, 0.6]))
    assert held.theta[0] == pytest.approx(0.5, rel=1e-3)
    problem = logarithmic(1.0001)
    assert held.mse == pytest.approx(float(problem.measurement.mse(held.y[None])[0]), rel=1e-12)
    assert held.objective > held.mse
    free = LeastSquaresTRF().minimize(rc_problem(noise=0.2), np.array([0.3, 0.6]))
    assert held.mse > free.mse
    assert free.objective == free.mse


def test_the_penalty_is_what_is_written() -> None:
    problem = logarithmic(1.5, centre=2.0)
    prior = problem.prior
    assert prior is not None
    u = problem.space.to_unit(np.array([[3.0, 1e4], [2.0, 1e4], [2.0 / 1.5, 4e4]]))
    np.testing.assert_allclose(prior.deviations(u), [[1.0, 0.0], [0.0, 0.0], [-1.0, 0.0]], atol=1e-12)
    m = problem.measurement.n_samples
    np.testing.assert_allclose(prior.penalty(u), np.array([1.0, 0.0, 1.0]) * SENSOR**2 / m, atol=1e-15)
    answer = problem.evaluate(u)
    np.testing.assert_array_equal(answer.objective, answer.mse + prior.penalty(u))
    np.testing.assert_allclose(
        np.sum(prior.rows(u, m) ** 2, axis=1) / m + answer.mse, answer.objective, rtol=1e-12
    )


def test_gradient_and_curvature_of_the_penalty_are_exact() -> None:
    # Slopes of rows that were wrong would miss the closed form; these would miss it by too little.
    prior = line_problem().prior
    assert prior is not None
    u, step = np.array([0.2, 0.5, 0.9]), 1e-6
    found = prior.expand(u)
    moved = prior.penalty(u + step * np.eye(3))
    np.testing.assert_allclose((moved - found.value) / step, found.gradient, rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(found.hessian, np.diag(prior.row_slopes(12) ** 2) * 2 / 12, rtol=1e-12)


def measured(uncertainty: float = 0.5, lasts_s: float = 0.0) -> Measurement:
    posed = Measurement.on_grid(TIME, np.sin(TIME)[:, None], ("y",), np.array([uncertainty]))
    return with_each(posed, error_lasts_s=lasts_s)


def test_errors_that_last_make_a_prior_weigh_more() -> None:
    space = Line().parameter_space
    white, slow = Prior.of(space, measured()), Prior.of(space, measured(lasts_s=5.0))
    assert white is not None
    assert slow is not None
    assert white.n_independent == len(TIME)
    rho = np.exp(-1.0 / 5.0)
    assert slow.n_independent == pytest.approx(len(TIME) * (1.0 - rho) / (1.0 + rho))
    assert slow.weight == pytest.approx(SENSOR**2 / slow.n_independent)
    assert independent_samples(measured(lasts_s=1e9)) == 1.0
    assert measured(lasts_s=5.0).digest == measured().digest


def test_a_sensor_of_unknown_uncertainty_weighs_nothing() -> None:
    with pytest.raises(InputError, match=r"outputs\[y\]: .*give uncertainty, or remove prior"):
        Prior.of(Line().parameter_space, measured(uncertainty=np.inf))


def test_a_prior_of_other_parameters_is_refused() -> None:
    with pytest.raises(ValueError, match="the prior is of 3 parameters, the model has 2"):
        replace(rc_problem(), prior=line_problem().prior)
