"""Model exchange with events, failures and both FMI versions, against closed forms."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exchange_for_tests import build, run, settings

from simulation import FmuModel


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("exchange"), request.param)


def bounces(time: Any, restitution: float, slowest: float) -> tuple[Any, Any]:
    """Height and number of bounces of a ball dropped from 1 m, flight by flight."""
    g, height, count = 9.81, np.zeros(len(time)), np.zeros(len(time))
    begin, speed, end = -np.sqrt(2.0 / g), np.sqrt(2.0 * g), np.sqrt(2.0 / g)
    n = 0
    while True:
        inside = (time >= max(begin, 0.0)) & (time < end)
        height[inside] = speed * (time[inside] - begin) - 0.5 * g * (time[inside] - begin) ** 2
        count[inside] = n
        n, speed, begin = n + 1, speed * restitution, end
        if speed <= slowest:
            count[time >= begin] = n
            return height, count
        end = begin + 2.0 * speed / g


def test_a_ball_bounces_and_rests(fmu: Path):
    edges = np.linspace(0.0, 4.0, 81)
    answer = run(fmu, "BALL", a=0.7, b=0.3, edges=edges, rtol=1e-8)
    height, count = bounces(edges, 0.7, 0.3)
    assert answer.failures == ("",)
    np.testing.assert_allclose(answer.y[0, :, 0], height, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(answer.y[0, :, 1], count)


@pytest.mark.parametrize("period", [7.0, 10.0, 35.0])
def test_time_events_take_place_on_time(fmu: Path, period: float):
    """Also where one falls on an output: the output then shows what the event leaves behind."""
    edges = np.arange(21) * 10.0
    answer = run(fmu, "TRIANGLE", a=period, edges=edges)
    turns = np.floor(edges / period)
    rest = edges - turns * period
    expected = np.where(turns % 2 == 0, rest, period - rest)
    np.testing.assert_allclose(answer.y[0, :, 0], expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(answer.y[0, :, 1], turns)


def test_a_completed_step_can_ask_for_an_event(fmu: Path):
    answer = run(fmu, "SAW", edges=np.arange(101) * 0.1)
    assert answer.failures == ("",)
    # Between two resets lie a little more than a second: the internal step that goes past 1 is at most 0.1 s.
    assert 9 <= answer.y[0, -1, 1] <= 10
    assert 1.0 <= answer.y[0, :, 0].max() <= 1.1
    assert answer.y[0, -1, 0] < 1.0


def linear_by_steps(a: float, b: float, u: Any, step: float) -> Any:
    """Exact solution of LINEAR, inputs held; the output after each step still sees the step's input."""
    from scipy.linalg import expm

    matrix = np.array([[-a, 0.0, 1.0], [1.0, -b, 0.0], [0.0, 0.0, 0.0]])
    transition = expm(matrix * step)
    x, y = np.array([b, 0.0, 0.0]), [u[0]]
    for value in u:
        x[2] = value
        x = transition @ x
        y.append(x[1] + value)
    return np.array(y)


@pytest.mark.parametrize("output_every", [1, 5])
def test_inputs_hold_over_their_step_and_jump_after_it(fmu: Path, output_every: int):
    u = np.repeat(np.random.default_rng(0).normal(size=30), np.tile([1, 1, 3, 1, 4], 6))[:60]
    edges = np.arange(61) * 2.0
    answer = run(fmu, "LINEAR", a=0.3, b=0.05, edges=edges, u=u, rtol=1e-8, output_every=output_every)
    np.testing.assert_allclose(
        answer.y[0, :, 0], linear_by_steps(0.3, 0.05, u, 2.0)[::output_every], rtol=1e-8, atol=5e-7
    )


@pytest.mark.parametrize("output_every", [1, 5])
def test_outputs_see_the_inputs_at_their_time_where_these_are_given(fmu: Path, output_every: int):
    """Not those of the step before: what feeds through would lag half a step. What moves sees the steps'."""
    edges = np.arange(61) * 2.0
    at_edges = np.random.default_rng(0).normal(size=61)
    u = 0.5 * (at_edges[1:] + at_edges[:-1])
    chosen = settings(fmu, "LINEAR", edges=edges, u=u, rtol=1e-8, output_every=output_every)
    off, at_off = np.zeros((60, 1)), np.ones((61, 1))
    scenario = dataclasses.replace(
        chosen.scenario,
        inputs=np.column_stack([off, u]),
        input_names=("off", "u"),
        # A Boolean cannot be set in continuous time, so nothing sees it.
        inputs_at_edges=np.column_stack([at_off, at_edges]),
    )
    with FmuModel(dataclasses.replace(chosen, scenario=scenario)) as model:
        first, again = model.simulate(np.array([[0.3, 0.05], [0.3, 0.05]])).y[..., 0]
    before = np.concatenate([u[:1], u])
    expected = (linear_by_steps(0.3, 0.05, u, 2.0) - before + at_edges)[::output_every]
    np.testing.assert_allclose(first, expected, rtol=1e-8, atol=5e-7)
    np.testing.assert_array_equal(first, again)


def test_inputs_of_every_type_hold_over_their_step_and_a_local_variable_is_read(fmu: Path):
    rng = np.random.default_rng(1)
    u, off, level = rng.normal(size=60), rng.integers(0, 2, 60), rng.integers(-3, 4, 60)
    chosen = settings(fmu, "LINEAR", edges=np.arange(61) * 2.0, u=u, rtol=1e-8)
    scenario = dataclasses.replace(
        chosen.scenario,
        inputs=np.column_stack([level, u, off]).astype(np.float64),
        input_names=("level", "u", "off"),
    )
    with FmuModel(dataclasses.replace(chosen, scenario=scenario, output_names=("x0", "x1"))) as model:
        answer = model.simulate(np.array([[0.3, 0.05]]))
    assert answer.failures == ("",)
    driven = np.where(off, 0.0, u) + level
    x1 = linear_by_steps(0.3, 0.05, driven, 2.0)[1:] - driven
    np.testing.assert_allclose(answer.y[0, 1:, 1], x1, rtol=1e-8, atol=2e-6)
    x0 = [0.05]
    for value in driven:
        x0.append(x0[-1] * np.exp(-0.6) + value * (1.0 - np.exp(-0.6)) / 0.3)
    np.testing.assert_allclose(answer.y[0, :, 0], x0, rtol=1e-8, atol=2e-6)


@pytest.mark.parametrize(
    ("mode", "reason"),
    [
        ("NOT_A_NUMBER", r"^the integrator's .* at 100 s; the derivative of x1 is not finite$"),
        (
            "BROKEN",
            r"^the integrator's .* at 100 s; fmi[23]Get\w*Derivatives returned fmi[23]Error at 100 s$",
        ),
        ("ENDS", r"^the FMU asked to end the simulation at 100 s$"),
        ("ESCAPE", r"^the integrator.* at 0\.9999\d* s"),
        ("NOISY", r"^the integrator needed more than 100000 steps in one communication step at"),
    ],
)
def test_a_row_that_fails_says_why(fmu: Path, mode: str, reason: str):
    # Constant inputs but one, so that RESTLESS and CHATTERS have an event after 100 s.
    u = np.where(np.arange(20) == 11, 1.0, 0.0)
    answer = run(fmu, mode, edges=np.arange(21) * 10.0, u=u)
    assert np.isnan(answer.y).all()
    with pytest.raises(AssertionError, match=reason):
        raise AssertionError(answer.failures[0])


def test_nominal_values_set_the_absolute_tolerance(fmu: Path):
    """A state of 1e-7 is nothing to a nominal value of 1, and all to one of 1e-7."""
    errors = []
    for nominal in (1.0, 1e-7):
        u = 1e-7 * (np.arange(40) % 2)
        answer = run(fmu, "LINEAR", a=1.0, b=0.5, edges=np.arange(41) * 1.0, u=u, rtol=1e-6, nominal=nominal)
        expected = linear_by_steps(1.0, 0.5, u, 1.0)
        errors.append(np.abs(answer.y[0, 20:, 0] - expected[20:]).max())
    assert errors[1] < errors[0] / 10.0
    # A thousandth of the input.
    assert errors[1] < 1e-10
