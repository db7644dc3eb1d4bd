"""Model exchange of the example cases against their own exact co-simulation and another integrator."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from simulation import load_case
from simulation.case import Case
from simulation.fmi.fmu import FmuSettings

REPOSITORY = Path(__file__).parents[2]


def settings_of(name: str) -> FmuSettings:
    return load_case(REPOSITORY / "fmus" / name).settings


@pytest.mark.parametrize(
    ("name", "tolerance", "share"),
    [
        # Of 300 K, as a share of some 7 K.
        ("office", 1e-6, 1e-4),
        # FMI 3.0, two outputs.
        ("wall", 1e-6, 1e-3),
        # A slow crossing of a threshold turns errors of the temperature into errors of time.
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


def wall_in_model_exchange(folder: Path, step_s: float) -> Case:
    """The wall, whose heat flow into the plaster follows the room at once."""
    text = (REPOSITORY / "fmus" / "wall" / "case.toml").read_text(encoding="utf-8")
    for before, after in (
        ('"co-simulation"', '"model-exchange"'),
        ('"Wall.fmu"', f'"{REPOSITORY / "fmus" / "wall" / "Wall.fmu"}"'),
        ('"../../data/wall"', f'"{REPOSITORY / "data" / "wall"}"'),
        ("[time]", "relative_tolerance = 1e-9\n[time]"),
    ):
        assert text.count(before) == 1
        text = text.replace(before, after)
    (folder / "case.toml").write_text(text, encoding="utf-8")
    return load_case(folder, communication_step_s=step_s)


def test_an_output_that_an_input_feeds_through_to_lags_no_half_step(tmp_path: Path):
    coarse, fine = (wall_in_model_exchange(tmp_path, step_s) for step_s in (600.0, 10.0))
    theta = coarse.parameter_space.expected[None]
    lagging = dataclasses.replace(
        coarse.settings, scenario=dataclasses.replace(coarse.scenario, inputs_at_edges=None)
    )
    answers = []
    for chosen in (fine.settings, coarse.settings, lagging):
        with chosen.open() as model:
            answers.append(model.simulate(theta).y[0])
    exact, good, late = answers
    error, before = (np.abs(one - exact)[:, 1].max() for one in (good, late))
    assert error < 0.1 * before
    # What moves sees the steps' inputs either way.
    np.testing.assert_array_equal(good[:, 0], late[:, 0])
    assert coarse.model_digest != dataclasses.replace(coarse, scenario=lagging.scenario).model_digest
