"""Samples that are not equally sure: a column of standard uncertainties, a share of the value."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from decaying_case_for_tests import (
    NOISE_K,
    TRUE_K,
    TRUE_X0,
    DecayingCase,
    driving,
    fitted,
    states,
    table,
)

from simulation import InputError, load_case
from studies import Problem

TIME = np.arange(0.0, 57601.0, 600.0)
SURE = "uncertainty = 0.05"


def recorded(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return values and standard uncertainties: every other sample is sixty times as unsure."""
    deviations = np.where(np.arange(len(TIME)) % 2, 60.0 * NOISE_K, NOISE_K)
    noise = np.random.default_rng(seed).standard_normal(len(TIME)) * deviations
    return states(TIME) + noise, deviations


def written(folder: Path, values: np.ndarray, deviations: np.ndarray, keys: str) -> Path:
    file = DecayingCase(measured=table("time_s,x,sd", TIME, values, deviations)).write(folder)
    file.write_text(file.read_text().replace(SURE, keys))
    return file


@pytest.mark.parametrize("seed", range(3))
def test_unsure_samples_count_less(tmp_path: Path, seed: int) -> None:
    values, deviations = recorded(seed)
    k, x0, _ = fitted(written(tmp_path / "own", values, deviations, 'uncertainty_column = "sd"'))
    # Twice what the noise of the sure samples moves them by (the linearised fit has 0.3 % and 0.03 K).
    assert abs(k / TRUE_K - 1.0) < 0.006
    assert abs(x0 - TRUE_X0) < 0.06
    alike = fitted(written(tmp_path / "alike", values, deviations, SURE))
    assert abs(alike[0] / TRUE_K - 1.0) > abs(k / TRUE_K - 1.0)


def test_the_error_is_the_mean_weighed_by_uncertainties(tmp_path: Path) -> None:
    values, deviations = recorded(0)
    case = load_case(written(tmp_path, values, deviations, 'uncertainty_column = "sd"'))
    y = states(TIME)[None, :, None] + 0.3
    weights = deviations**-2.0
    expected = np.sum(weights * (y[0, :, 0] - values) ** 2) / np.sum(weights)
    np.testing.assert_allclose(case.measurement.mse(y), expected, rtol=1e-6)
    np.testing.assert_allclose(case.outputs[0].uncertainty, np.mean(weights) ** -0.5)
    other = load_case(written(tmp_path / "other", values, 2.0 * deviations, 'uncertainty_column = "sd"'))
    assert other.measurement.digest != case.measurement.digest


def test_a_share_of_the_value_comes_beside_the_sensors_uncertainty(tmp_path: Path) -> None:
    values, deviations = recorded(0)
    case = load_case(written(tmp_path, values, deviations, f"{SURE}\nuncertainty_share = 0.01"))
    np.testing.assert_allclose(case.outputs[0].samples.deviations, np.hypot(0.05, 0.01 * values), rtol=1e-6)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("", "key uncertainty is missing; add it, or uncertainty_column"),
        (
            f'{SURE}\nuncertainty_column = "sd"',
            "uncertainty_column and uncertainty both give the uncertainty",
        ),
        (
            'uncertainty_column = "sd"\nuncertainty_share = 0.1',
            "uncertainty_column and uncertainty_share both give",
        ),
        (f'{SURE}\nuncertainty_share = 0.1\nnormalize = "range"', "normalize replaces uncertainties"),
        ('uncertainty_column = "error"', "error"),
        ('uncertainty_column = "sd"', "measured.csv: line 7: sd is 0 beside a measured value; give an"),
    ],
)
def test_what_is_not_said_once_is_refused(tmp_path: Path, keys: str, said: str) -> None:
    values, deviations = recorded(0)
    deviations[5] = 0.0
    with pytest.raises(InputError, match=said) as refused:
        load_case(written(tmp_path, values, deviations, keys))
    assert "\n" not in str(refused.value)


def test_an_experiment_has_another_one(tmp_path: Path) -> None:
    values, deviations = recorded(0)
    file = written(tmp_path, values, deviations, SURE)
    more = '\n[[experiments]]\nname = "a"\n[[experiments]]\nname = "b"\n'
    more += 'outputs = [{ name = "y", uncertainty_column = "sd" }]\n'
    file.write_text(file.read_text() + more)
    first, second = load_case(file).outputs
    assert (first.uncertainty, first.samples.deviations) == (0.05, None)
    np.testing.assert_allclose(second.samples.deviations, deviations)


def test_a_problem_of_objects_takes_a_series(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    values, deviations = recorded(0)
    monkeypatch.chdir(tmp_path)
    DecayingCase().write(tmp_path)
    y = {"values": pd.Series(values, TIME), "uncertainty": pd.Series(deviations, TIME), "unit": "K"}
    problem = Problem(
        tmp_path / "fmus" / "decay" / "decay.fmu",
        {"y": y},
        {"k": {"lower": 2e-5, "upper": 5e-4, "scale": "log"}, "x0": (280.0, 340.0)},
        {"u": pd.Series(driving(TIME), TIME)},
    )
    np.testing.assert_allclose(problem.case.outputs[0].samples.deviations, deviations)


def with_replicates(folder: Path, seed: int, *, keys: str = "") -> Path:
    """Write three replicates of each moment, of which some are missing; the third is an outlier of none."""
    rng = np.random.default_rng(seed)
    cells = [states(TIME) + 0.3 * rng.standard_normal(len(TIME)) for _ in range(3)]
    text = table("time_s,x1,x2,x3", TIME, *cells).splitlines()
    for row in rng.integers(1, len(text), 40):
        text[row] = ",".join(text[row].split(",")[:3]) + ","
    text[5] = ",".join(text[5].split(",")[:1]) + ",,,"
    file = DecayingCase(measured="\n".join(text) + "\n").write(folder)
    replicates = f'replicates = ["x1", "x2", "x3"]\n{keys}'
    file.write_text(file.read_text().replace('column = "x"\n', replicates).replace(SURE + "\n", ""))
    return file


@pytest.mark.parametrize("seed", range(3))
def test_replicates_are_their_mean_as_sure_as_they_agree(tmp_path: Path, seed: int) -> None:
    file = with_replicates(tmp_path, seed)
    (one,) = load_case(file).outputs
    assert len(one.samples.time) == len(TIME) - 1
    assert one.samples.deviations is not None
    np.testing.assert_allclose(
        np.unique(one.samples.deviations)[[0, -1]], [0.3 / 3**0.5, 0.3 / 2**0.5], rtol=0.2
    )
    k, x0, rms = fitted(file)
    assert rms < 2.0 * 0.3 / 2**0.5
    assert abs(k / TRUE_K - 1.0) < 0.02
    assert abs(x0 - TRUE_X0) < 0.3


def test_replicates_of_a_sensor_whose_uncertainty_is_known(tmp_path: Path) -> None:
    (one,) = load_case(with_replicates(tmp_path, 0, keys="uncertainty = 0.6\n")).outputs
    assert one.samples.deviations is not None
    np.testing.assert_allclose(np.unique(one.samples.deviations), [0.6 / 3**0.5, 0.6 / 2**0.5])


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"x3"]', '"x3"]\ncolumn = "x1"', "replicates says what column says; drop one"),
        ('"x3"]', '"x3"]\nuncertainty_share = 0.1', "uncertainty_share beside replicates; write a column"),
        ('["x1", "x2", "x3"]', '["x1", "x1"]', "replicates do not differ, so nothing is known"),
        ('["x1", "x2", "x3"]', '["x1"]', "at least 2"),
        ('"x3"]', '"x9"]', "column x9 is missing"),
    ],
)
def test_replicates_that_cannot_be_are_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    file = with_replicates(tmp_path, 0)
    file.write_text(file.read_text().replace(old, new))
    with pytest.raises(InputError, match=said):
        load_case(file)
