"""Model exchange of the example cases against their own exact co-simulation and another integrator."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from simulation import load_case
from simulation.fmi.fmu import FmuSettings

REPOSITORY = Path(__file__).parents[2]


def settings_of(name: str) -> FmuSettings:
    return load_case(REPOSITORY / "fmus" / name).settings


@pytest.mark.parametrize(
    ("name", "tolerance", "share"),
    [
        # Of 300 K, as a share of some 7 K.
        ("office", 1e-6, 1e-4),
        ("office", 1e-8, 1e-6),
        # FMI 3.0, two outputs.
        ("wall", 1e-6, 1e-3),
        ("wall", 1e-8, 5e-5),
        # A slow crossing of a threshold turns errors of the temperature into errors of time.
        ("thermostat", 1e-6, 0.05),
        ("thermostat", 1e-8, 1e-3),
    ],
)
def test_both_interfaces_agree_within_the_tolerance(name: str, tolerance: float, share: float):
    chosen = settings_of(name)
    space = chosen.parameter_space
    theta = space.from_unit(np.random.default_rng(0).random((3, space.n_parameters)))
    with chosen.open() as exact:
        expected = exact.simulate(theta)
    exchange = dataclasses.replace(chosen, interface="model-exchange", relative_tolerance=tolerance)
    with exchange.open() as model:
        answer = model.simulate(theta)
    assert answer.failures == expected.failures == ("", "", "")
    error = np.abs(answer.y - expected.y).max(axis=(0, 1))
    np.testing.assert_array_less(error, share * np.ptp(expected.y, axis=1).max(axis=0))


def test_a_longer_communication_step_changes_nothing_but_the_outputs():
    """CVODE runs on where the inputs stay: twice as many edges, the same trajectory."""
    chosen = dataclasses.replace(settings_of("vanderpol"), relative_tolerance=1e-9)
    scenario = chosen.scenario
    edges = scenario.time_communication
    finer = dataclasses.replace(
        scenario,
        time_communication=np.sort(np.concatenate([edges, 0.5 * (edges[1:] + edges[:-1])])),
        inputs=np.repeat(scenario.inputs, 2, axis=0),
        output_every=2 * scenario.output_every,
    )
    theta = chosen.parameter_space.from_unit(np.full((1, chosen.parameter_space.n_parameters), 0.5))
    with chosen.open() as model:
        coarse = model.simulate(theta)
    with dataclasses.replace(chosen, scenario=finer).open() as model:
        fine = model.simulate(theta)
    np.testing.assert_allclose(fine.y, coarse.y, rtol=0, atol=1e-5 * np.abs(coarse.y).max())
