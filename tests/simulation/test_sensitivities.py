"""Trajectory sensitivities against exact solutions, another integrator, and FMUs that lie or have none."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exchange_for_tests import build, settings
from scipy.integrate import solve_ivp
from test_exchange import linear_by_steps

from simulation.case import load_case
from simulation.errors import InputError
from simulation.fmi.fmu import FmuModel, FmuSettings
from simulation.parameters import Parameter, ParameterSpace

REPOSITORY = Path(__file__).parents[2]
U = np.repeat(np.random.default_rng(0).normal(size=20), np.tile([1, 1, 3, 1, 4], 4))
EDGES = np.arange(len(U) + 1) * 2.0


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def fmu(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("smooth"), request.param, n_states=2, n_indicators=0)


def case_settings(name: str, **changes: Any) -> FmuSettings:
    return dataclasses.replace(load_case(REPOSITORY / "fmus" / name).settings, **changes)


def central(answer: Any, theta: Any, relative: float) -> Any:
    """Central differences of answer(theta), shape (t, k), along every parameter. Shape (t, k, p)."""
    columns = []
    for step in np.diag(relative * theta):
        columns.append((answer(theta + step) - answer(theta - step)) / (2.0 * step.sum()))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("output_every", [1, 5])
def test_they_are_those_of_the_exact_solution(fmu: Path, output_every: int):
    """Parameter b acts on a rate and on a start value."""
    theta = np.array([0.3, 0.7])

    def exact(values: Any) -> Any:
        return linear_by_steps(values[0], values[1], U, 2.0)[::output_every, None]

    chosen = settings(fmu, "LINEAR", edges=EDGES, u=U, rtol=1e-8, output_every=output_every)
    chosen = dataclasses.replace(chosen, output_names=("y",), output_offsets=np.zeros(1))
    with FmuModel(chosen) as model:
        assert model.provides_sensitivities
        answer, slopes = model.sensitivities(np.array([theta, theta * 1.1]))
        again = model.simulate(np.array([theta, theta * 1.1]))
    assert answer.failures == ("", "")
    np.testing.assert_array_equal(answer.y, again.y)
    for i, values in enumerate((theta, theta * 1.1)):
        # The tolerance of the sensitivities is 1e-4 of them; central differences are good to 1e-8.
        np.testing.assert_allclose(slopes[i], central(exact, values, 1e-4), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("interface", ["co-simulation", "model-exchange"])
def test_the_office_has_them_by_both_interfaces(interface: Any):
    chosen = case_settings("office", interface=interface, relative_tolerance=1e-8)
    u = np.random.default_rng(4).random((1, chosen.parameter_space.n_parameters))
    theta = chosen.parameter_space.from_unit(u)
    with dataclasses.replace(chosen, interface="co-simulation").open() as exact:
        expected = central(lambda values: exact.simulate(values[None]).y[0], theta[0], 1e-4)
    with chosen.open() as model:
        answer, slopes = model.sensitivities(theta)
        np.testing.assert_array_equal(answer.y, model.simulate(theta).y)
    # By how much the output moves if a parameter changes by all of itself. [K]
    apart = np.abs(slopes[0] - expected).max(axis=(0, 1)) * theta[0]
    np.testing.assert_array_less(apart, 1e-3)
    assert np.abs(expected[:, 0] * theta[0]).max() > 1.0


def test_van_der_pol_agrees_with_another_integrator():
    chosen = case_settings("vanderpol", relative_tolerance=1e-9)
    names = chosen.parameter_space.names
    theta = chosen.parameter_space.from_unit(np.full((1, len(names)), 0.4))[0]
    time = chosen.scenario.time_simulated

    def other(values: Any) -> Any:
        start = {"mu": 1.0, "period": 7200.0, "amplitude": 1.0, "xStart": 1.0, "vStart": 0.0}
        start |= {name: value for name, value in chosen.fixed.items() if isinstance(value, float)}
        p = start | dict(zip(names, values, strict=True))
        omega = 2.0 * np.pi / p["period"]
        solution = solve_ivp(
            lambda _, x: [omega * x[1], omega * (p["mu"] * (1.0 - x[0] ** 2) * x[1] - x[0])],
            (time[0], time[-1]),
            [p["xStart"], p["vStart"]],
            method="DOP853",
            t_eval=time,
            rtol=1e-12,
            atol=1e-12,
        )
        return p["amplitude"] * solution.y[0][chosen.scenario.n_warmup :, None]

    with chosen.open() as model:
        answer, slopes = model.sensitivities(theta[None])
    assert answer.failures == ("",)
    np.testing.assert_allclose(answer.y[0], other(theta), rtol=0, atol=1e-5 * np.abs(other(theta)).max())
    expected = central(other, theta, 1e-5)
    scale = np.abs(expected).max(axis=(0, 1))
    np.testing.assert_array_less(np.abs(slopes[0] - expected).max(axis=(0, 1)), 1e-3 * scale)


def test_units_are_the_declared_ones(fmu: Path):
    chosen = settings(fmu, "LINEAR", edges=EDGES, u=U)
    converted = dataclasses.replace(
        chosen,
        output_factors=np.array([10.0, 1.0]),
        parameter_factors=np.array([0.01, 1.0]),
        parameter_offsets=np.array([0.1, 0.0]),
        output_names=("y", "y"),
    )
    with FmuModel(dataclasses.replace(chosen, output_names=("y", "y"))) as model:
        plain = model.sensitivities(np.array([[0.3, 0.7]]))[1]
    with FmuModel(converted) as model:
        answer, slopes = model.sensitivities(np.array([[20.0, 0.7]]))
    assert answer.failures == ("",)
    np.testing.assert_allclose(slopes[0, :, 0, 0], 0.1 * plain[0, :, 0, 0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(slopes[0, :, 0, 1], 10.0 * plain[0, :, 0, 1], rtol=1e-9, atol=1e-12)


def test_models_with_state_events_have_none():
    with case_settings("thermostat").open() as model:
        assert not model.provides_sensitivities
        with pytest.raises(InputError, match=r"gives no trajectory sensitivities \(it has state events\)"):
            model.sensitivities(model.parameter_space.from_unit(np.full((1, 6), 0.5)))


def smooth(fmu: Path, mode: str, *, names: tuple[str, ...] = ("a", "b")) -> FmuSettings:
    chosen = settings(fmu, mode, edges=np.arange(21) * 10.0)
    space = ParameterSpace(tuple(Parameter(name, -1e9, 1e9) for name in names))
    return dataclasses.replace(chosen, parameter_space=space, output_names=("y",), output_offsets=np.zeros(1))


def test_a_time_event_fails_the_row(fmu: Path):
    with FmuModel(smooth(fmu, "TRIANGLE")) as model:
        answer, slopes = model.sensitivities(np.array([[35.0, 0.0]]))
    assert answer.failures[0].startswith("the model has an event at 35 s")
    assert np.isnan(slopes).all()
    assert np.isnan(answer.y).all()


def test_derivatives_that_lie_are_found_out(fmu: Path):
    """For this model the FMU returns the derivatives of another one."""
    with (
        FmuModel(smooth(fmu, "PULSED")) as model,
        pytest.raises(InputError, match="contradict finite differences of y"),
    ):
        model.sensitivities(np.array([[0.1, 0.1]]))


def test_a_parameter_without_derivatives_fails_the_row(fmu: Path):
    with FmuModel(smooth(fmu, "LINEAR", names=("a", "nominal"))) as model:
        answer, _ = model.sensitivities(np.array([[0.1, 1.0]]))
    assert "GetDirectionalDerivative returned" in answer.failures[0]


def test_interfaces_that_disagree_fail_the_row():
    """At this tolerance the office by model exchange is 0.8 % of its range from its exact co-simulation."""
    with case_settings("office", relative_tolerance=3.0).open() as model:
        theta = model.parameter_space.from_unit(np.full((1, 14), 0.3))
        answer, slopes = model.sensitivities(theta)
        assert model.simulate(theta).failures == ("",)
    assert answer.failures[0].startswith("model exchange differs from co-simulation by")
    assert np.isnan(slopes).all()
