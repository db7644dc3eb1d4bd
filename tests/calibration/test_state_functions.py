"""State equations with functions (flows, drag, angles), and equations that no row of a design has shown."""

from dataclasses import replace

import numpy as np
import pytest
from moving_for_tests import Moving, box, measured, with_equations

from simulation.arrays import FloatArray
from simulation.parameters import Parameter, ParameterSpace
from studies.calibration.state_equations.flow import SteppedFlow
from studies.calibration.state_equations.learned_ode import LearnedODE
from studies.calibration.state_equations.states import WatchedModel
from studies.calibration.state_equations.terms import FUNCTIONS, Sum, Term

N_STEPS = 200


def pulses(low: float, high: float, seed: int) -> FloatArray:
    levels = np.random.default_rng(seed).uniform(low, high, N_STEPS // 20)
    return np.repeat(levels, 20)


def signed_root(v: FloatArray) -> FloatArray:
    return np.sign(v) * np.sqrt(np.abs(v))


TANKS = Moving(
    box(A1=(0.3, 3.0), A2=(0.3, 3.0), k1=(3e-3, 3e-2), k2=(3e-3, 3e-2), h=(0.5, 2.0)),
    ("m", "m", "m3/s", "1"),
    10.0,
    np.column_stack([pulses(0.0, 0.02, 1), pulses(0.2, 1.0, 2)]),
    lambda a1, a2, k1, k2, h, x, y, q, valve: [
        (q - k1 * signed_root(x - y)) / a1,
        (k1 * signed_root(x - y) - k2 * valve * signed_root(y)) / a2,
    ],
    lambda a1, a2, k1, k2, h: [h, 0.5 + 0.0 * h],
)
CAR = Moving(
    box(m=(200.0, 2000.0), cw=(2.0, 20.0), slope=(30.0, 500.0)),
    ("m/s", "N"),
    1.0,
    pulses(-4000.0, 4000.0, 3)[:, None],
    lambda m, cw, slope, v, force: [(force - cw * v * np.abs(v) - slope) / m],
    lambda m, cw, slope: [5.0 + 0.0 * m],
)
PENDULUM = Moving(
    box(l=(0.3, 3.0), d=(0.05, 0.5), phi=(0.5, 3.0)),
    ("rad", "rad/s"),
    0.05,
    np.empty((N_STEPS, 0)),
    lambda length, d, phi, x, w: [w, -9.81 / length * np.sin(x) - d * w],
    lambda length, d, phi: [phi, 0.0 * phi],
)
PLATE = Moving(
    box(C=(2e3, 2e4), h=(0.5, 5.0), G=(0.5, 5.0)),
    ("K", "K", "W"),
    60.0,
    np.column_stack([pulses(285.0, 300.0, 4), pulses(0.0, 200.0, 5)]),
    lambda c, h, g, t, room, power: [
        (power - h * (t - room) * np.cbrt(np.abs(t - room)) - g * (t - room)) / c
    ],
    lambda c, h, g: [290.0 + 0.0 * c],
)
TERMS = {
    "tanks": {Term(2), Term(1, True, function="root")},
    "car": {Term(1), Term(0, function="square"), Term(-1)},
    "pendulum": {Term(1)},
    "plate": {Term(2), Term(1, True), Term(1, True, function="natural convection")},
}


@pytest.mark.parametrize("name", TERMS)
def test_functions_are_found_and_a_calibration_takes_five_calls(name: str) -> None:
    model = {"tanks": TANKS, "car": CAR, "pendulum": PENDULUM, "plate": PLATE}[name]
    truth = np.full((1, model.parameter_space.n_parameters), 0.6)
    problem = measured(model, model.parameter_space.from_unit(truth)[0], 0.01)
    found, ode = with_equations(problem, max_calls=20)
    assert ode.is_sure
    assert ode.model is not None
    equations = ode.model.equations
    assert isinstance(equations.flow, SteppedFlow)
    assert set(equations.structure.sums[0].terms) == TERMS[name]
    assert found.n_calls <= 6
    assert found.mse <= 1.001 * problem.mse(truth)[0]
    # The optimum's own simulation is one of few rows that they are learnt from; these are not.
    theta = model.parameter_space.from_unit(np.random.default_rng(1).random((4, truth.shape[1])))
    expected = model.simulate(theta).y[..., :1]
    np.testing.assert_allclose(ode.model.simulate(theta).y, expected, rtol=0.0, atol=5e-3 * expected.std())


@pytest.mark.parametrize("name", FUNCTIONS)
def test_compiled_steps_take_the_functions_that_terms_have(name: str) -> None:
    values = np.array([-2.3, -0.4, 0.0, 0.7, 3.1])
    for value in values:
        signals = replace(TANKS.signals, driven=np.tile([value, 1.0], (N_STEPS, 1)))
        flow = SteppedFlow(signals, (Sum(0, (Term(2, function=name),)), Sum(1, (Term(-1),))))
        assert not flow.unsolved
        x = flow.states(np.zeros((2, 1)), [np.ones((1, 1)), np.zeros((1, 1))])
        # The slope is the function of a constant.
        expected = FUNCTIONS[name](np.array(value)) * TANKS.step_s * N_STEPS
        np.testing.assert_allclose(x[0, -1, 0], expected, rtol=1e-9, atol=1e-12)


def test_a_function_that_no_step_takes_is_not_solved_as_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(FUNCTIONS, "saturation", np.tanh)
    model = replace(CAR, slope=lambda m, cw, slope, v, force: [(force - 100.0 * cw * np.tanh(v)) / m])
    problem = measured(model, model.parameter_space.from_unit(np.full((1, 3), 0.6))[0], 0.01)
    found, ode = with_equations(problem, max_calls=12)
    assert not ode.is_learnt
    assert ode.why_not == 'the function "saturation" has no compiled steps'
    assert np.isfinite(found.mse)


def test_a_point_is_solved_alike_whatever_it_is_solved_beside() -> None:
    terms = (Term(2), Term(1, True, function="root"))
    flow = SteppedFlow(TANKS.signals, (Sum(0, terms), Sum(1, (Term(0, True, function="root"),))))
    start = np.random.default_rng(0).random((2, 7))
    rates = [np.column_stack([np.full(7, 0.5), np.linspace(0.001, 0.01, 7)]), np.full((7, 1), 0.01)]
    together = flow.states(start, rates)
    # One that runs away stays alone with it.
    wild = [np.where(np.arange(7)[:, None] == 3, 1e300, rates[0]), rates[1]]
    with np.errstate(all="ignore"):
        beside = flow.states(start, wild)
    assert not np.isfinite(beside[3, -1]).any()
    for row in range(7):
        alone = flow.states(start[:, [row]], [one[[row]] for one in rates])
        np.testing.assert_array_equal(alone[0], together[row])
        assert row == 3 or np.array_equal(beside[row], together[row])
    assert flow.states(start[:, :0], [one[:0] for one in rates]).shape == (0, N_STEPS + 1, 2)


def test_points_are_asked_where_either_state_goes_farthest() -> None:
    problem = measured(TANKS, TANKS.parameter_space.from_unit(np.full((1, 5), 0.6))[0], 0.01)
    ode = LearnedODE.of(problem)
    design = 0.4 + 0.2 * np.random.default_rng(0).random((6, 5))
    ode.note(problem.evaluate(design))
    assert ode.is_sure
    seen = problem.model.seen(problem.space.from_unit(design)).x
    points = ode.unseen(design[0], 4, np.random.default_rng(1))
    model = WatchedModel(TANKS, TANKS.signals)
    x = model.seen(model.simulate(problem.space.from_unit(points)).theta).x
    for state in range(2):
        assert x[..., state].max() > seen[..., state].max()
        assert x[..., state].min() < seen[..., state].min()


WEIR = Moving(
    ParameterSpace(
        (
            *box(A=(0.5, 5.0), k=(3e-3, 3e-2)).parameters,
            Parameter("hWeir", 0.5, 12.0),
            *box(kWeir=(5e-3, 0.2)).parameters,
        )
    ),
    ("m", "m3/s"),
    18.0,
    pulses(0.0, 0.02, 3)[:, None],
    lambda a, k, weir, k_weir, h, q: [(q - k * h - k_weir * np.maximum(h - weir, 0.0)) / a],
    lambda a, k, weir, k_weir: [1.0 + 0.0 * a],
)


HEATER = Moving(
    box(UA=(50.0, 150.0), C=(5e5, 2e7), Kp=(300.0, 3000.0), PMax=(1e3, 3e4)),
    ("K", "K"),
    900.0,
    pulses(268.0, 290.0, 7)[:, None],
    lambda ua, c, kp, p_max, t, out: [(ua * (out - t) + np.minimum(p_max, kp * (294.0 - t))) / c],
    lambda ua, c, kp, p_max: [293.0 + 0.0 * c],
)


def test_forms_that_held_and_hold_no_more_are_given_up() -> None:
    """A heater that is never off at full power, as in no row before, moves by terms that are known."""
    problem = measured(HEATER, np.array([100.0, 5e6, 1000.0, 1400.0]), 0.15)
    _, ode = with_equations(problem, max_calls=10, misfit_threshold=0.09)
    assert not ode.is_believed
    assert ode.without_effect == ()


def test_a_form_that_no_row_has_shown_is_looked_for_before_equations_end_a_search() -> None:
    """Over a weir that lies high flows nothing; where nothing did, the equations know of none."""
    theta = np.array([1.5, 0.006, 1.0, 0.01])
    problem, truth = measured(WEIR, theta, 0.02), WEIR.parameter_space.to_unit(theta)
    ode = LearnedODE.of(problem)
    rows = np.random.default_rng(0).random((6, 4))
    rows[:, 2] = 0.8 + 0.2 * rows[:, 2]
    ode.note(problem.evaluate(rows))
    assert ode.is_sure
    assert ode.left_out.tolist() == [False, False, True, True]
    assert ode.without_effect == ("hWeir", "kWeir")
    points = ode.unseen(truth, 6, np.random.default_rng(0))
    assert points.shape == (6, 4)
    assert points[0].tolist() == [*truth[:2], 0.0, 0.0]
    assert points[1].tolist() == [*truth[:2], 1.0, 1.0]
    # Where the error is too large, and where an uncertain sensor might explain it.
    for threshold in (0.04**2, 1.0):
        _, ode = with_equations(problem, max_calls=10, misfit_threshold=threshold)
        assert not ode.is_believed
