"""Means over an interval: the truth is recovered from them; taken for moments they are named by the check."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from decaying_case_for_tests import (
    NOISE_K,
    TRUE_K,
    TRUE_X0,
    DecayingCase,
    fitted,
    noise,
    states,
    table,
)

from simulation.case import load_case
from studies.doctor.answers import coverage_points
from studies.doctor.finding import Finding
from studies.doctor.means import look_at_means, rows_for_means
from studies.doctor.mixups import look_at_scales

FINE = np.arange(0.0, 57601.0, 60.0)
OFFSETS = {"end": 0.0, "begin": 3600.0, "centre": 1800.0}


def measured(stamp: str, length_s: float = 3600.0, seed: int = 0) -> str:
    """Return a CSV file of means over one interval after the other."""
    x, n = states(FINE), round(length_s / 60.0)
    begins = range(0, len(FINE) - n, n)
    values = np.array([np.trapezoid(x[i : i + n + 1]) / n for i in begins])
    times = np.array([FINE[i + n] for i in begins]) - OFFSETS[stamp] * length_s / 3600.0
    return table("time_s,x", times, values + noise(len(values), seed))


def written(folder: Path, stamp: str, output: str = "", **more: float) -> Path:
    # A whole number of intervals; where the case says nothing of them, the last stamp is the end.
    time = "window_s = [0, 54000]" if output or stamp == "end" else "window_s = [0, 50400]"
    return DecayingCase(measured=measured(stamp, **more), output=output, time=time).write(folder)


def found(file: Path) -> list[Finding]:
    case = load_case(file)
    with case.open_model() as model:
        return list(look_at_means(case, model.simulate, model.simulate(coverage_points(case))))


@pytest.mark.parametrize("stamp", OFFSETS)
@pytest.mark.parametrize("length_s", [3600.0, 5400.0])
def test_the_truth_is_found_from_means(tmp_path: Path, stamp: str, length_s: float) -> None:
    key = f"mean_over_s = {length_s:g}" + f'\nmean_stamp = "{stamp}"' * (stamp != "end")
    k, x0, rms = fitted(written(tmp_path, stamp, key, length_s=length_s))
    assert rms < 2.0 * NOISE_K
    assert (k, x0) == (pytest.approx(TRUE_K, rel=0.01), pytest.approx(TRUE_X0, abs=0.2))


def test_means_that_follow_closely_overlap(tmp_path: Path) -> None:
    """As of a logger that writes the mean over the last hour every ten minutes."""
    x = states(FINE)
    ends = np.arange(60, len(FINE), 10)
    values = np.array([np.trapezoid(x[i - 60 : i + 1]) / 60 for i in ends]) + noise(len(ends))
    file = DecayingCase(measured=table("time_s,x", FINE[ends], values), output="mean_over_s = 3600")
    k, x0, rms = fitted(file.write(tmp_path))
    assert rms < 2.0 * NOISE_K
    assert (k, x0) == (pytest.approx(TRUE_K, rel=0.01), pytest.approx(TRUE_X0, abs=0.2))


@pytest.mark.parametrize(
    ("stamp", "keys"),
    [("end", "mean_over_s = 3600"), ("begin", 'mean_over_s = 3600 and mean_stamp = "begin"')],
)
def test_means_that_are_taken_for_moments_are_named(tmp_path: Path, stamp: str, keys: str) -> None:
    (one,) = found(written(tmp_path, stamp))
    assert one.level == "warn"
    assert f"that {stamp} at the stamps fit y far better" in one.found
    assert one.remedy == f"if the recording holds means, say so: outputs[y] {keys}"


@pytest.mark.parametrize("seed", range(3))
def test_moments_are_not_taken_for_means(tmp_path: Path, seed: int) -> None:
    time = np.arange(0.0, 57601.0, 3600.0)
    moments = table("time_s,x", time, states(time) + noise(len(time), seed))
    assert found(DecayingCase(measured=moments).write(tmp_path / "moments")) == []
    # Nor are means that the case says.
    assert found(written(tmp_path / "said", "end", "mean_over_s = 3600")) == []
    # Nor is what another fault of the model or the data makes.
    shifted = table("time_s,x", time, states(time) + 3.0 * np.sin(time / 900.0))
    assert found(DecayingCase(measured=shifted).write(tmp_path / "wrong")) == []


def test_few_samples_say_nothing_of_it(tmp_path: Path) -> None:
    case = load_case(written(tmp_path, "end"))
    assert rows_for_means(case) > 0
    few = replace(
        case.outputs[0],
        samples=replace(
            case.outputs[0].samples, time=np.array([0.0, 9e3, 18e3]), values=np.array([300.0, 301.0, 302.0])
        ),
    )
    case = replace(case, measurement=replace(case.measurement, outputs=(few,)))
    assert rows_for_means(case) == 0


def test_what_was_taken_late_or_is_off_is_named(tmp_path: Path) -> None:
    time = np.arange(0.0, 57601.0, 3600.0)
    late = table("time_s,x", time, states(np.maximum(time - 1800.0, 0.0)) + noise(len(time)))
    # Half an hour late; the first sample is not.
    (one,) = found(
        DecayingCase(measured=late, time="window_s = [7200, 57600]\nstart_s = 0").write(tmp_path / "late")
    )
    assert one.key in ("shifted", "means")
    assert "far better" in one.found


def test_a_constant_offset_is_named(tmp_path: Path) -> None:
    """Of a model whose level is known: the input and the begin say where it has to lie."""
    time = np.arange(0.0, 57601.0, 3600.0)
    file = DecayingCase(measured=table("time_s,x", time, states(time) + 4.0 + noise(len(time)))).write(
        tmp_path
    )
    file.write_text(file.read_text().replace("lower = 280\nupper = 340", "lower = 311.5\nupper = 312.5"))
    (one,) = found(file)
    assert one.key == "offset"
    said = re.search(r"y fits far better if the measured values are (\S+) K too high: ", one.found)
    assert said is not None
    # The static gain makes up for a part, as far as the noise leaves that open.
    assert float(said[1]) == pytest.approx(4.0, abs=0.8)


@pytest.mark.parametrize(
    ("factor", "said"), [(1e-3, "times 1000"), (3600.0, "divided by 3600"), (3.6e6, "divided by 3600000")]
)
def test_a_factor_between_units_is_named(tmp_path: Path, factor: float, said: str) -> None:
    time = np.arange(0.0, 57601.0, 600.0)
    unit = {'unit="K"/>': 'unit="W"/>', '<Unit name="K"/>': '<Unit name="K"/><Unit name="W"/>'}
    text = table("time_s,x", time, factor * (states(time) + noise(len(time))))
    file = DecayingCase(measured=text, change=unit).write(tmp_path)
    file.write_text(file.read_text().replace('unit = "K"\n', 'unit = "W"\n'))
    case = load_case(file)
    with case.open_model() as model:
        known = model.simulate(coverage_points(case))
        (one,) = look_at_scales(case, known)
        right = load_case(DecayingCase().write(tmp_path / "right"))
        assert [*look_at_scales(right, known)] == []
    assert f"y: simulations reach the measured values {said}, and not as they are" in one.found


@pytest.mark.parametrize("offset", [-273.15, 273.15])
def test_kelvin_taken_for_celsius_are_named(tmp_path: Path, offset: float) -> None:
    time = np.arange(0.0, 57601.0, 600.0)
    case = load_case(DecayingCase(measured=table("time_s,x", time, states(time) + offset)).write(tmp_path))
    with case.open_model() as model:
        (one,) = look_at_scales(case, model.simulate(coverage_points(case)))
    assert f"measured values {-offset:+g}, and" in one.found
