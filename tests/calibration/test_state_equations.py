"""State equations that are learnt from what a model's states did, and calibrations that follow them."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from simulation.arrays import FloatArray
from simulation.case import load_case
from simulation.errors import InputError
from simulation.measurement import Measurement
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.adaptive import Adaptive, AdaptiveResult
from studies.calibration.coefficient import Points
from studies.calibration.first_design import latin_hypercube
from studies.calibration.learned_ode import LearnedODE
from studies.calibration.problem import CalibrationProblem
from studies.calibration.product_forms import Products
from studies.calibration.state_equations import LEARNT, StateEquations, Structure
from studies.calibration.states import StateRows, StateSignals, WatchedModel, watching_states

REPOSITORY = Path(__file__).parents[2]
STEP_S, EVERY, N_STEPS = 600.0, 2, 120


def weather() -> FloatArray:
    """Outdoor temperature [K], power [W], and whether a fan is on [1], over the steps."""
    time = STEP_S * np.arange(N_STEPS)
    fan = (time % 20000.0 > 12000.0).astype(float)
    return np.column_stack([275.0 + 6.0 * np.sin(time / 9000.0), 400.0 * np.cos(time / 4000.0) ** 2, fan])


@dataclass(frozen=True)
class TwoRooms:
    """Two rooms, one with a window, a heater and a fan to the other; answers the room, states and slopes.

    Solved exactly by the matrix exponential, held inputs step by step.
    """

    parameter_space: ParameterSpace = field(
        default_factory=lambda: ParameterSpace(
            (
                Parameter("R", 2e-3, 5e-2, scale="log"),
                Parameter("ROut", 5e-3, 1e-1, scale="log"),
                Parameter("GFan", 5.0, 80.0, scale="log"),
                Parameter("C", 2e5, 5e6, scale="log"),
                Parameter("TStart", 285.0, 295.0),
            )
        )
    )
    roughness: float = 0.0
    output_names: tuple[str, ...] = ("TRoom", "T1", "T2", "der(T1)", "der(T2)")
    time: FloatArray = field(default_factory=lambda: EVERY * STEP_S * np.arange(N_STEPS // EVERY + 1))

    def slope(self, theta: FloatArray, x: FloatArray, u: FloatArray) -> FloatArray:
        r, r_out, fan, c, _ = theta
        c = c * (1.0 + self.roughness * np.sin(300.0 * np.log(c)))
        between = (x[1] - x[0]) / r + u[2] * fan * (x[1] - x[0])
        return np.array([(between + (u[0] - x[0]) / r_out + u[1]) / c, -between / (3.0 * c)])

    def after(self, theta: FloatArray, x: FloatArray, inputs: FloatArray) -> FloatArray:
        """Return the states and their slopes at the end of each step. Shape (t, 4)."""
        rows, steps = [], {}
        for u in inputs:
            if u[2] not in steps:
                at_rest = self.slope(theta, np.zeros(2), u)
                rates = np.column_stack([self.slope(theta, one, u) - at_rest for one in np.eye(2)])
                step = expm(STEP_S * rates)
                steps[u[2]] = step, np.linalg.solve(rates, step - np.eye(2))
            step, gain = steps[u[2]]
            x = step @ x + gain @ self.slope(theta, np.zeros(2), u)
            rows.append([*x, *self.slope(theta, x, u)])
        return np.array(rows)

    def simulate(self, theta: FloatArray) -> Trajectories:
        inputs, y = weather(), []
        for row in theta:
            x = np.array([row[4], row[4]])
            first = [*x, *self.slope(row, x, inputs[0])]
            kept = np.vstack([first, self.after(row, x, inputs)])[::EVERY]
            y.append(np.column_stack([kept[:, 0] - 273.15, kept]))
        return Trajectories.checked(
            theta,
            np.array(y),
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
        )


ROOMS = StateSignals(
    states=("T1", "T2"),
    derivatives=("der(T1)", "der(T2)"),
    inputs=("TOut", "P", "fan"),
    units=("K", "K", "K", "W", "1"),
    depends_on=(None, frozenset({"T1", "T2", "fan"})),
    driven=weather(),
    step_s=STEP_S,
    every=EVERY,
    n_before=0,
    outputs=("TRoom",),
    conversions=np.array([[1.0, -273.15]]),
)


def rows_of(model: TwoRooms, n: int, seed: int) -> tuple[FloatArray, StateRows]:
    u = 0.1 + 0.8 * latin_hypercube(n, 5, np.random.default_rng(seed))
    watched = WatchedModel(model, ROOMS)
    return u, watched.seen(watched.simulate(model.parameter_space.from_unit(u)).theta)


def learnt(u: FloatArray, rows: StateRows, space: ParameterSpace) -> StateEquations:
    structure = Structure.of(ROOMS, rows)
    assert structure.misfit < LEARNT
    found, _ = structure.fitted(ROOMS, rows)
    equations = StateEquations.learn(ROOMS, structure, Points.of(space, u), rows.x, found, Products.of(space))
    assert isinstance(equations, StateEquations)
    return equations


def test_terms_and_trajectories_of_a_network_are_found_from_a_few_rows() -> None:
    model = TwoRooms()
    u, rows = rows_of(model, 8, seed=0)
    equations = learnt(u, rows, model.parameter_space)
    first, second, room = (
        {(term.column, term.is_difference, term.factors) for term in one.terms}
        for one in equations.structure.sums
    )
    assert first == {(1, True, ()), (2, True, ()), (3, False, ()), (1, True, (4,))}
    assert second == {(0, True, ()), (0, True, (4,))}
    assert room == {(0, False, ()), (-1, False, ())}
    fresh = np.random.default_rng(1).random((6, 5))
    expected = model.simulate(model.parameter_space.from_unit(fresh)).y[..., :1]
    answered = equations.outputs(Points.of(model.parameter_space, fresh))
    np.testing.assert_allclose(answered, expected, atol=1e-5)


def problem_of(rooms: TwoRooms, truth: FloatArray) -> CalibrationProblem:
    watched = WatchedModel(rooms, ROOMS)
    y = watched.simulate(truth[None]).y[0] + 0.05 * np.random.default_rng(0).standard_normal((61, 1))
    return CalibrationProblem(watched, Measurement.on_grid(rooms.time, y, ("TRoom",), np.array([0.05])))


def with_equations(
    problem: CalibrationProblem, seed: int, **settings: int
) -> tuple[AdaptiveResult, LearnedODE]:
    ode = LearnedODE.of(problem)
    chosen = Adaptive(**settings)  # type: ignore[arg-type]
    return chosen.minimize(problem, seed=seed, learned_ode=ode), ode


TRUTH = np.array([1e-2, 2e-2, 30.0, 1e6, 291.0])


def test_a_calibration_by_equations_takes_two_calls_more_than_it_learns_from() -> None:
    problem = problem_of(TwoRooms(), TRUTH)
    found, ode = with_equations(problem, 0, max_calls=40)
    assert ode.is_believed
    assert found.converged
    assert "state equations" in found.stop_reason
    truth = float(problem.mse(problem.space.to_unit(TRUTH[None]))[0])
    assert found.mse < truth
    assert found.history.calls_to(truth) <= 8
    assert found.n_calls <= 12


def test_where_coefficients_are_no_formulas_the_search_does_without() -> None:
    found, ode = with_equations(problem_of(TwoRooms(roughness=0.8), TRUTH), 0, max_calls=12)
    assert ode.n_asked == 0
    assert not ode.is_learnt
    assert ode.why_not == "not all coefficients are formulas of the parameters"
    assert found.n_calls == 12
    assert np.isfinite(found.mse)


def test_a_wall_is_calibrated_with_little_more_than_a_call_per_parameter() -> None:
    """tests/end_to_end/test_tutorials.py asks the same of the office."""
    case = load_case(REPOSITORY / "fmus" / "wall")
    with watching_states(case).open_model() as model:
        problem = CalibrationProblem(WatchedModel(model, StateSignals.of(case)), case.measurement)
        found, ode = with_equations(problem, 0, max_calls=100)
    assert ode.n_asked > 0
    assert found.n_calls <= 13
    assert found.mse <= 1.01 * 0.00192


@dataclass(frozen=True)
class Kicked(TwoRooms):
    """One state jumps once, which no derivative shows."""

    kick: float = 0.1

    def simulate(self, theta: FloatArray) -> Trajectories:
        answer = super().simulate(theta)
        y = answer.y.copy()
        for row, one in enumerate(theta):
            after = self.after(one, y[row, 30, 1:3] + [self.kick, 0.0], weather()[30 * EVERY :])
            y[row, 31:, 1:] = after[EVERY - 1 :: EVERY]
            y[row, 31:, 0] = y[row, 31:, 1] - 273.15
        return replace(answer, y=y)


def test_what_jumps_between_is_not_predicted_and_nothing_is_sure() -> None:
    problem = problem_of(Kicked(), TRUTH)
    _, ode = with_equations(problem, 0, max_calls=20)
    assert not ode.is_sure
    assert ode.model is None


def test_where_the_best_fit_is_a_bad_one_the_first_design_is_asked_to_the_end() -> None:
    case = load_case(REPOSITORY / "fmus" / "wall")
    with watching_states(case).open_model() as model:
        problem = CalibrationProblem(WatchedModel(model, StateSignals.of(case)), case.measurement)
        found = [
            Adaptive(max_calls=40, misfit_threshold=threshold).minimize(
                problem, seed=0, learned_ode=LearnedODE.of(problem)
            )
            for threshold in (0.1, 1e-4)
        ]
    assert found[0].n_calls < 7
    # Four points where equations may act that no row has shown, and the rest of the design.
    assert found[1].n_calls == 4 + 7 + found[0].n_calls - 4
    assert all(one.converged for one in found)


def test_a_watched_model_answers_what_it_answers_unwatched() -> None:
    case = load_case(REPOSITORY / "fmus" / "wall")
    theta = case.parameter_space.from_unit(np.random.default_rng(0).random((3, 7)))
    signals = StateSignals.of(case)
    with case.open_model() as model, watching_states(case).open_model() as more:
        watched = WatchedModel(more, signals)
        alone, answer = model.simulate(theta), watched.simulate(theta)
    np.testing.assert_array_equal(answer.y, alone.y)
    np.testing.assert_array_equal(answer.time, alone.time)
    assert answer.output_names == alone.output_names
    # The day before the window is the row's own, and is watched from its start.
    assert signals.n_before == 144
    assert watched.seen(theta).x.shape == (3, len(alone.time) + 144, 3)
    assert watching_states(case).model_digest != case.model_digest


def test_an_fmu_without_states_is_refused() -> None:
    case = load_case(REPOSITORY / "fmus" / "wall")
    silent = replace(case, fmu=replace(case.fmu, states=()))
    with pytest.raises(InputError, match=r"declares no states.*leave --state-equations away"):
        watching_states(silent)
