"""Sums, counters, values on change, inputs that are means: the truth is found, or one line refuses them."""

from pathlib import Path

import numpy as np
import pytest
from decaying_case_for_tests import (
    NOISE_K,
    TRUE_K,
    TRUE_X0,
    DecayingCase,
    driving,
    fitted,
    noise,
    states,
    table,
)

from simulation import InputError, load_case

FINE = np.arange(0.0, 57601.0, 60.0)
POWER = {'<Unit name="K"/>': '<Unit name="K"/><Unit name="W"/>', '<Real unit="K"/>': '<Real unit="W"/>'}
"""The state is called a power: its integral is an energy."""
KWH = 3.6e6


def energy(times: np.ndarray) -> np.ndarray:
    """Return the integral of the state up to times that are whole minutes. Shape (m,). [kWh]."""
    x = states(FINE)
    whole = np.append(0.0, np.cumsum(0.5 * (x[1:] + x[:-1]) * 60.0))
    return np.interp(times, FINE, whole) / KWH


def recovered(file: Path, of_noise: float = 2.0) -> None:
    k, x0, rms = fitted(file)
    assert rms < of_noise * NOISE_K
    assert (k, x0) == (pytest.approx(TRUE_K, rel=0.02), pytest.approx(TRUE_X0, abs=0.4))


def power_case(
    folder: Path, text: str, output: str, unit: str = "kWh", time: str = "window_s = [0, 54000]"
) -> Path:
    case = DecayingCase(measured=text, output=output, change=POWER, time=time)
    file = case.write(folder)
    sure = NOISE_K * 3600.0 / KWH if unit == "kWh" else NOISE_K * 3600.0
    new = f'unit = "{unit}"\nfile = "measured.csv"\ncolumn = "x"\nuncertainty = {sure:.6g}'
    old = 'unit = "K"\nfile = "measured.csv"\ncolumn = "x"\nuncertainty = 0.05'
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    return file


@pytest.mark.parametrize(("stamp", "unit"), [("end", "kWh"), ("begin", "J"), ("centre", "kWh")])
def test_energies_of_an_hour_are_compared_with_the_power(tmp_path: Path, stamp: str, unit: str) -> None:
    ends = np.arange(3600.0, 57601.0, 3600.0)
    values = np.diff(energy(np.append(0.0, ends))) + noise(len(ends)) / 1000.0
    values *= 1.0 if unit == "kWh" else KWH
    text = table("time_s,x", ends - {"end": 0.0, "begin": 3600.0, "centre": 1800.0}[stamp], values)
    file = power_case(tmp_path, text, f'sum_over_s = 3600\nmean_stamp = "{stamp}"', unit)
    (one,) = load_case(file).outputs
    assert (one.unit, one.uncertainty) == ("W", pytest.approx(NOISE_K, rel=1e-4))
    recovered(file)


@pytest.mark.parametrize("wraps", [0.0, 1.0])
def test_a_meter_that_had_run_before(tmp_path: Path, wraps: float) -> None:
    """Every half hour, without some readings; of four digits it begins at 0 again."""
    at = np.delete(np.arange(0.0, 57601.0, 1800.0), [5, 6, 17])
    values = 48.2 + energy(at) + 2e-5 * np.random.default_rng(1).standard_normal(len(at))
    keys = 'starts_at = "first"'
    if wraps:
        values, keys = values % wraps, f"{keys}\nwraps_at = {wraps}"
    file = power_case(tmp_path, table("time_s,x", at, values), keys, time="window_s = [0, 57600]")
    case = load_case(file)
    assert case.outputs[0].unit == "W"
    # 32 half hours but those beside the four missing readings.
    assert len(case.outputs[0].samples.time) == 32 - 3 - 2
    recovered(file, of_noise=3.0)


@pytest.mark.parametrize("begin_s", [0, 14400])
def test_a_counter_of_what_the_fmu_counts_itself(tmp_path: Path, begin_s: int) -> None:
    time = np.arange(0.0, 57601.0, 600.0)
    text = table("time_s,x", time, states(time) + noise(len(time)) + 5123.0)
    window = f"window_s = [{begin_s}, 57600]\nstart_s = 0"
    file = DecayingCase(measured=text, output='starts_at = "first"', time=window).write(tmp_path)
    case = load_case(file)
    assert case.outputs[0].samples.since_s == begin_s
    assert len(case.outputs[0].samples.time) == (57600 - begin_s) / 600
    y = states(case.measurement.time)[None, :, None]
    np.testing.assert_allclose(case.measurement.mse(y + 7.0), case.measurement.mse(y))
    # In pictures and tables the counter begins where the simulation is then.
    shown = case.outputs[0].samples.beside(case.measurement.time, y[0, :, 0])
    assert np.sqrt(np.mean((shown - y[0, 1:, 0]) ** 2)) < 2.0 * NOISE_K
    recovered(file)


def test_counters_of_experiments_count_from_their_own_begin(tmp_path: Path) -> None:
    time = np.arange(0.0, 57601.0, 600.0)
    text = table("time_s,x", time, states(time) + 5123.0)
    file = DecayingCase(
        measured=text, output='starts_at = "first"', time="window_s = [7200, 57600]\nstart_s = 0"
    ).write(tmp_path)
    alone = load_case(file).measurement
    file.write_text(file.read_text() + '[[experiments]]\nname = "a"\n[[experiments]]\nname = "b"\n')
    both = load_case(file).measurement
    row = np.random.default_rng(0).normal(300.0, 1.0, (1, 85, 1))
    found = both.differences(np.repeat(row, 2, axis=2), 1)
    np.testing.assert_allclose(found, alone.differences(row, 0), atol=1e-9)


def test_values_recorded_on_change_hold_until_the_next(tmp_path: Path) -> None:
    """Recorded where the state has moved by 0.5 K; another column has records of its own."""
    x, rows, last = states(FINE), ["time_s,x,other"], np.inf
    for time, value in zip(FINE, x, strict=True):
        if abs(value - last) >= 0.5 or time == FINE[-1]:
            rows.append(f"{time:g},{value:.6g},")
            last = value
        elif time % 7200.0 == 0.0:
            rows.append(f"{time:g},,1")
    file = DecayingCase(measured="\n".join(rows) + "\n", output="on_change = true").write(tmp_path)
    samples = load_case(file).outputs[0].samples
    assert len(samples.time) == 97
    assert np.max(np.abs(samples.values - states(samples.time))) < 0.51
    # The deadband is the noise.
    k, x0, rms = fitted(file)
    assert rms < 0.5
    assert (k, x0) == (pytest.approx(TRUE_K, rel=0.05), pytest.approx(TRUE_X0, abs=0.5))


@pytest.mark.parametrize("how", ["held", "smooth"])
@pytest.mark.parametrize(("stamp", "later_s"), [("end", 3600.0), ("begin", 0.0), ("centre", 1800.0)])
def test_an_input_of_hourly_means_keeps_its_energy(
    tmp_path: Path, how: str, stamp: str, later_s: float
) -> None:
    u = driving(FINE)
    begins = np.arange(0.0, 57600.0, 3600.0)
    n = 60
    means = np.array([np.trapezoid(u[i * n : i * n + n + 1]) / n for i in range(len(begins))])
    file = DecayingCase(inputs=table("time_s,u", begins + later_s, means)).write(tmp_path)
    text = file.read_text().replace(
        'interpolation = "linear"', f'interpolation = "{how}"\nmean_over_s = 3600\nmean_stamp = "{stamp}"'
    )
    file.write_text(text)
    inputs = load_case(file).scenario.inputs[:, 0]
    np.testing.assert_allclose(inputs.reshape(-1, 6).mean(axis=1), means, rtol=1e-8)
    k, x0, rms = fitted(file)
    # Held means leave steps of an hour in the input, and no other error.
    assert rms < (2.0 * NOISE_K if how == "smooth" else 0.2)
    assert (k, x0) == (pytest.approx(TRUE_K, rel=0.02), pytest.approx(TRUE_X0, abs=0.4))


def test_an_input_of_hourly_sums_is_their_mean(tmp_path: Path) -> None:
    begins = np.arange(0.0, 57600.0, 3600.0)
    cases = [DecayingCase(inputs=table("time_s,u", begins, driving(begins) * size)) for size in (1.0, 3600.0)]
    loaded = []
    for name, case, unit in zip("ab", cases, ('"K/s"\nmean_over_s', '"K"\nsum_over_s'), strict=True):
        file = case.write(tmp_path / name)
        text = file.read_text().replace('unit = "K/s"', f'unit = {unit} = 3600\nmean_stamp = "begin"')
        file.write_text(text.replace('interpolation = "linear"', 'interpolation = "held"'))
        loaded.append(load_case(file).scenario.inputs)
    np.testing.assert_allclose(*loaded, rtol=1e-9)


@pytest.mark.parametrize(
    ("output", "said"),
    [
        ("sum_over_s = 3600", 'unit = "K" is of the kind of the FMU\'s "K", and the sum of a rate'),
        ("sum_over_s = 3600\nmean_over_s = 3600", "mean_over_s beside sum_over_s: a sample stands for one"),
        ('on_change = true\nstarts_at = "first"', "starts_at beside on_change"),
        ("wraps_at = 100", "wraps_at is of a counter; add starts_at"),
        ('starts_at = "first"\nat_most = 3.0', "at_most beside starts_at has no clear unit; drop it"),
        ('starts_at = "first"', "x falls from 299 to 1 in line 51; if it began at 0 again there, say where"),
        (
            'starts_at = "first"\nwraps_at = 1e4',
            "falls from 299 to 1 in line 51, and wraps_at = 10000; correct",
        ),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, output: str, said: str) -> None:
    time = np.arange(0.0, 57601.0, 600.0)
    values = np.where(time < 29400.0, 251.0 + time / 600.0, time / 600.0 - 48.0)
    file = DecayingCase(measured=table("time_s,x", time, values), output=output).write(tmp_path)
    with pytest.raises(InputError, match=said):
        load_case(file)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("mean_over_s = 3600", "has a value every 600 s, and each is said to go over 3600 s"),
        ('mean_stamp = "begin"', "mean_stamp is of means; add mean_over_s"),
        ("sum_over_s = 600", 'unit = "K/s" is of the kind of the FMU\'s "K/s"'),
    ],
)
def test_inputs_that_cannot_be_are_refused(tmp_path: Path, keys: str, said: str) -> None:
    file = DecayingCase().write(tmp_path)
    file.write_text(file.read_text().replace('interpolation = "linear"', f'interpolation = "held"\n{keys}'))
    with pytest.raises(InputError, match=said):
        load_case(file)


def test_means_of_an_input_are_not_joined_by_lines(tmp_path: Path) -> None:
    file = DecayingCase().write(tmp_path)
    file.write_text(file.read_text().replace('"linear"', '"linear"\nmean_over_s = 600'))
    with pytest.raises(InputError, match='between means changes them; write "held" or "smooth"'):
        load_case(file)
