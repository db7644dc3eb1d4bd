"""The example models against closed forms and tight solutions, their cases against known truths."""

from dataclasses import replace

import numpy as np
import pytest
from fmu_for_tests import REPOSITORY
from generated_data import generator_of

from simulation import FmuModel, Parameter, ParameterSpace, load_case
from simulation.case import named_experiments
from simulation.scenario import Scenario

FOLDERS = {name: REPOSITORY / "fmus" / name for name in ("vanderpol", "wall", "thermostat", "two-rooms")}


@pytest.fixture(scope="module", params=FOLDERS)
def name(request):
    return request.param


def simulate(case, parameters, *, inputs=None, step_s=None, n_steps=None, tolerance=None):
    """One row with these parameters of the FMU, from time 0; outputs in the FMU's units."""
    settings = case.settings
    space = ParameterSpace(tuple(Parameter(key, v - 1.0, v + 1.0) for key, v in parameters.items()))
    edges = step_s * np.arange(n_steps + 1)
    held = np.empty((n_steps, 0)) if inputs is None else inputs
    changed = replace(
        settings,
        parameter_space=space,
        scenario=Scenario(edges, held, settings.scenario.input_names, output_every=1),
        fixed={},
        accepted=None,
        relative_tolerance=tolerance,
        output_offsets=np.zeros(len(settings.output_names)),
        output_factors=None,
        parameter_factors=None,
        parameter_offsets=None,
    )
    with FmuModel(changed) as model:
        answer = model.simulate(np.array([list(parameters.values())]))
    assert answer.failures == ("",)
    return answer.y[0]


@pytest.mark.parametrize(
    "changes",
    [{}, {"mu": 0.2, "xStart": 2.0}, {"mu": 7.0, "period": 5000.0}, {"amplitude": 0.5, "period": 16000.0}],
)
def test_the_oscillator_follows_a_tight_solution(changes):
    generator, case = generator_of("vanderpol"), load_case(FOLDERS["vanderpol"])
    theta = {**generator.TRUTH, **changes}
    expected = generator.voltage(300.0 * np.arange(145), **theta)
    y = simulate(case, theta, step_s=300.0, n_steps=144, tolerance=1e-9)[:, 0]
    # An integrator at 1e-9 over some ten cycles, the steep flanks of a relaxation oscillation among them.
    np.testing.assert_allclose(y, expected, rtol=0, atol=2e-5 * np.ptp(expected))


@pytest.mark.parametrize("seed", range(2))
def test_the_wall_follows_its_matrix_exponential(seed):
    generator, case = generator_of("wall"), load_case(FOLDERS["wall"])
    rng = np.random.default_rng(seed)
    theta = {key: v * (1.0 if "T" in key else rng.uniform(0.2, 5.0)) for key, v in generator.TRUTH.items()}
    theta |= {key: rng.uniform(270.0, 300.0) for key in ("T1Start", "T2Start", "T3Start")}
    inputs = rng.uniform([285.0, 255.0], [300.0, 305.0], size=(300, 2))
    y = simulate(case, theta, inputs=inputs, step_s=600.0, n_steps=300)
    expected = generator.answer(inputs, 600.0, theta)
    np.testing.assert_allclose(y[:, 0], expected[:, 0], rtol=0, atol=1e-9)
    # A conductance of up to 300 W/K times a rounding of temperatures; under the input of the step that ended.
    before = np.vstack([inputs[:1], inputs])[:, 0]
    begun = np.append(inputs[:, 0], inputs[-1, 0])
    np.testing.assert_allclose(
        y[1:, 1], (expected[:, 1] + theta["GIn"] * (before - begun))[1:], rtol=0, atol=1e-7
    )


@pytest.mark.parametrize("changes", [{}, {"band": 0.5, "C": 3e5}, {"PHeat": 1500.0}, {"GWall": 300.0}])
def test_the_thermostat_switches_when_the_closed_form_does(changes):
    generator, case = generator_of("thermostat"), load_case(FOLDERS["thermostat"])
    theta = {**generator.TRUTH, **changes}
    outside = 275.0 + 4.0 * np.sin(np.arange(288) / 40.0)
    expected, n_switchings = generator.answer(outside, 300.0, theta)
    assert n_switchings > 20
    y = simulate(case, theta, inputs=outside[:, None], step_s=300.0, n_steps=288)
    # The root finder's 1e-10 s per switching, times 3e-3 K/s and 3 kW.
    np.testing.assert_allclose(y[:, 0], expected[:, 0], rtol=0, atol=1e-8)
    np.testing.assert_allclose(y[:, 1], expected[:, 1], rtol=0, atol=1e-2)


@pytest.mark.parametrize("seed", range(2))
def test_two_rooms_follow_their_matrix_exponential(seed):
    generator, case = generator_of("two-rooms"), load_case(FOLDERS["two-rooms"])
    rng = np.random.default_rng(seed)
    theta = {key: v * (1.0 if "T" in key else rng.uniform(0.2, 5.0)) for key, v in generator.TRUTH.items()}
    theta |= {key: rng.uniform(270.0, 300.0) for key in ("T1Start", "T2Start", "TWallStart")}
    theta["GDoor"] = 30.0 * seed
    inputs = rng.uniform([255.0, 0.0, 0.0, 0.0], [305.0, 500.0, 2000.0, 2000.0], size=(300, 4))
    y = simulate(case, theta, inputs=inputs, step_s=900.0, n_steps=300)
    np.testing.assert_allclose(y, generator.answer(inputs, 900.0, theta)[:, :2], rtol=0, atol=1e-8)


def test_the_truth_leaves_the_noise(name):
    whole, generator = load_case(FOLDERS[name]), generator_of(name)
    parts = list(named_experiments(whole)) or [("", whole)]
    for experiment, case in parts:
        truth = generator.TRUTH
        if experiment:
            start = int(case.scenario.time_communication[0] / generator.STEP_S)
            states = generator.states_of(generator.weather_and_heaters(np.random.default_rng(generator.SEED)))
            truth = truth | {"TWallStart": states[start, 2]}
        theta = np.array([[truth[key] for key in case.parameter_space.names]])
        with case.open_model() as model:
            answer = model.simulate(theta)
        assert answer.failures == ("",)
        for index, output in enumerate(case.outputs):
            rms = np.sqrt(np.mean(case.measurement.differences(answer.y, index) ** 2))
            # Sampled noise, and for the wall the weather between two of its samples.
            assert 0.3 < rms / output.uncertainty < 1.3


def test_the_recordings_are_rewritten_bit_for_bit(name, tmp_path, monkeypatch):
    generator = generator_of(name)
    monkeypatch.setattr(generator, "HERE", tmp_path)
    generator.main()
    kept = {path.name: path.read_bytes() for path in (REPOSITORY / "data" / name).glob("*.csv")}
    assert kept
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == kept
