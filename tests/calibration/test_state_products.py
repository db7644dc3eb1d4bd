"""State equations with products: flows times temperatures, radiation, oscillations."""

import numpy as np
import pytest
from moving_for_tests import FMUS, Moving, learnt, watched_case, with_equations

from simulation.arrays import FloatArray
from simulation.case import load_case
from simulation.errors import InputError
from simulation.parameters import Parameter, ParameterSpace
from studies.calibration.problem import CalibrationProblem
from studies.calibration.state_equations.coefficient import Points
from studies.calibration.state_equations.flow import LinearFlow, SteppedFlow
from studies.calibration.state_equations.learned_ode import LearnedODE
from studies.calibration.state_equations.terms import Sum, Term

STEP_S, EVERY, N_STEPS = 300.0, 2, 160
WATER = 4180.0
SPACE = ParameterSpace(
    (
        Parameter("C", 3e5, 3e6, scale="log"),
        Parameter("CWater", 2e5, 1e6, scale="log"),
        Parameter("G", 50.0, 400.0, scale="log"),
        Parameter("area", 5.0, 50.0, scale="log"),
        Parameter("TStart", 285.0, 295.0),
    )
)


def supply(n_levels: int | None) -> FloatArray:
    """Supply temperature [K], water flow [kg/s], of so many levels, and outdoor temperature [K]."""
    time = STEP_S * np.arange(N_STEPS)
    flow = 0.05 * (1.0 + np.sin(time / 3000.0))
    if n_levels is not None:
        flow = np.round(flow / 0.1 * (n_levels - 1)) * 0.1 / (n_levels - 1)
    return np.column_stack([310.0 + 10.0 * np.sin(time / 5000.0), flow, 275.0 + 5.0 * np.cos(time / 8000.0)])


def radiator(inputs: FloatArray, radiates: bool) -> Moving:
    """A room, water that heats it, and radiation to outside or a wall; shows the room and the heat."""

    def slope(c, c_water, g, area, _, room, water, t_sup, flow, out):
        given = g * (water - room)
        lost = 5.67e-8 * area * (room**4 - out**4) if radiates else area * (room - out)
        return [(given - lost) / c, (WATER * flow * (t_sup - water) - given) / c_water]

    return Moving(
        SPACE,
        ("K", "K", "K", "kg/s", "K"),
        STEP_S,
        inputs,
        slope,
        lambda *theta: [theta[4], theta[4] + 10.0],
        lambda theta, x, u: [x[0], WATER * u[1] * (u[0] - x[1])],
        (-273.15, 0.0),
        EVERY,
    )


@pytest.mark.parametrize(
    ("radiates", "n_levels", "kind"),
    [(False, 3, LinearFlow), (False, None, SteppedFlow), (True, 3, SteppedFlow)],
)
def test_flows_and_radiation_are_found_and_solved(radiates: bool, n_levels: int | None, kind: type) -> None:
    model = radiator(supply(n_levels), radiates)
    equations = learnt(model, 8)
    assert isinstance(equations.flow, kind)
    room, water, shown, heat = (set(one.terms) for one in equations.structure.sums)
    lost = {Term(0, factors=(0, 0, 0)), Term(4, factors=(4, 4, 4))} if radiates else {Term(4, True)}
    assert room == {Term(1, True), *lost}
    assert water == {Term(0, True), Term(2, True, (3,))}
    assert shown == {Term(0), Term(-1)}
    assert heat == {Term(1, factors=(3,)), Term(2, factors=(3,))}
    fresh = np.random.default_rng(1).random((5, 5))
    expected = model.simulate(SPACE.from_unit(fresh)).y[..., :2]
    answered = equations.outputs(Points.of(SPACE, fresh))
    assert np.abs(answered - expected)[..., 0].max() < 0.01
    assert np.abs(answered - expected)[..., 1].max() < 0.002 * np.abs(expected[..., 1]).max()


def test_reactions_in_a_stirred_tank_are_found() -> None:
    """A + B become C, of second order, in a tank that is flushed."""
    space = ParameterSpace(
        tuple(Parameter(name, low, 30.0 * low, scale="log") for name, low in (("V", 1.0), ("k", 1e-7)))
    )
    n = 200
    inputs = np.column_stack([1e-3 * (2.0 + np.sin(np.arange(n) / 9.0)), 500.0 + np.arange(n)])

    def slope(v, k, c_a, c_b, flow, c_in):
        rate = k * c_a * c_b
        return [flow / v * (c_in - c_a) - rate, -2.0 * rate]

    model = Moving(
        space,
        ("mol/m3", "mol/m3", "m3/s", "mol/m3"),
        60.0,
        inputs,
        slope,
        lambda v, k: [300.0 + 0.0 * v, 800.0 + 0.0 * v],
        depends_on=(None, frozenset({"x0", "x1"})),
    )
    equations = learnt(model, 4)
    assert set(equations.structure.sums[0].terms) == {Term(3, True, (2,)), Term(0, factors=(1,))}
    assert equations.structure.sums[1].terms == (Term(0, factors=(1,)),)
    fresh = np.random.default_rng(1).random((3, 2))
    expected = model.simulate(space.from_unit(fresh)).y[..., :1]
    np.testing.assert_allclose(equations.outputs(Points.of(space, fresh)), expected, rtol=1e-3)


def test_what_moves_too_fast_is_left_alone() -> None:
    signals = radiator(supply(3), radiates=False).signals
    flow = SteppedFlow(signals, (Sum(0, (Term(0, factors=(0,)),)), Sum(1, (Term(0, True),))))
    start, slow = np.array([[1.0], [2.0]]), [np.array([[-1e-4]]), np.array([[1e-3]])]
    fine = flow.fine_enough(start, slow)
    assert fine is not None
    exact = 1.0 / (1.0 + 1e-4 * EVERY * STEP_S * np.arange(N_STEPS // EVERY + 1))
    np.testing.assert_allclose(fine.states(start, slow)[0, :, 0], exact, rtol=1e-4)
    with np.errstate(all="ignore"):
        assert flow.fine_enough(start, [slow[0], np.array([[10.0]])]) is None


def test_a_learned_ode_needs_a_model_that_watches_its_states() -> None:
    case = load_case(FMUS / "wall")
    with case.open_model() as model:
        problem = CalibrationProblem(model, case.measurement)
        with pytest.raises(InputError, match="state equations need a WatchedModel"):
            LearnedODE.of(problem)


def test_an_oscillator_is_calibrated_with_a_handful_of_calls() -> None:
    with watched_case(FMUS / "vanderpol") as (_, problem):
        found, ode = with_equations(problem, 3, max_calls=30)
    assert ode.is_believed
    assert found.n_calls <= 10
    assert found.mse < 1.005 * 0.02002
