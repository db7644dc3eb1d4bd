"""Which moment of a recording is the model's time 0, and what is said where the two begin apart."""

import re
from pathlib import Path

import numpy as np
import pytest
from case_for_tests import edit

from simulation import InputError, load_case
from simulation.other_inputs import settings_with_inputs

SPLIT = ('file = "recording.csv"\ncolumn = "T_degC"', 'file = "room.csv"\ncolumn = "T_degC"')


def split(folder: Path, first_s: int = 9000, shift_s: float = 0.0, time: str = "time_s") -> None:
    """Give the output a file of its own, whose first row lies at `first_s`, and shift all times."""
    lines = (folder / "data" / "recording.csv").read_text().splitlines()[1:]
    rows = [[float(cell) for cell in line.split(",")] for line in lines]
    unit_s = {"time_s": 1.0, "time [min]": 60.0, "time [h]": 3600.0}[time]
    for name, column, begin in (("recording.csv", 2, 0), ("room.csv", 1, first_s)):
        header = f"{time},{'heating' if column == 2 else 'T_degC'}"
        kept = [f"{(row[0] + shift_s) / unit_s:.12g},{row[column]!r}" for row in rows if row[0] >= begin]
        (folder / "data" / name).write_text("\n".join([header, *kept]) + "\n")
    edit(folder, SPLIT, ("x0 = { first_measured", "# x0 = { first_measured"))
    edit(folder, ("window_d = [0.25, 0.75]", "window_s = [0, 64800]"))
    if time != "time_s":
        edit(folder, ("schema = 1", f'schema = 1\ntime_column = "{time}"'))


@pytest.mark.parametrize("time", ["time_s", "time [min]", "time [h]"])
def test_the_0_of_a_column_of_durations_is_the_model_s(decay_case: Path, time: str):
    split(decay_case, time=time)
    case = load_case(decay_case)
    assert case.scenario.time_communication[[0, -1]].tolist() == [0.0, 64800.0]
    assert case.measurement.outputs[0].samples.time[0] == 9000.0


def test_zero_first_makes_the_first_row_the_model_s_0(decay_case: Path):
    split(decay_case)
    edit(decay_case, ("[time]", '[time]\nzero = "first"'), ("window_s = [0, 64800]", "window_s = [0, 43200]"))
    case = load_case(decay_case)
    assert case.scenario.time_communication[[0, -1]].tolist() == [0.0, 43200.0]
    samples = case.measurement.outputs[0].samples
    # sin(t / 1e4) + 20 was written.
    np.testing.assert_allclose(samples.values, 20 + np.sin((samples.time + 9000) / 1e4), atol=1e-6)


def test_unix_seconds_ask_for_their_first_row(decay_case: Path):
    split(decay_case, first_s=0, shift_s=1_700_000_000)
    with pytest.raises(
        InputError, match=r"window_s = \[0, 64800\] ends before .*room\.csv begins, at 1\.7e\+09 s; .*"
    ) as error:
        load_case(decay_case)
    assert 'zero = "first" in [time] counts from the first row instead' in str(error.value)
    assert "\n" not in str(error.value)
    edit(decay_case, ("[time]", '[time]\nzero = "first"'))
    case = load_case(decay_case)
    assert case.scenario.time_communication[[0, -1]].tolist() == [0.0, 64800.0]
    assert case.measurement.outputs[0].samples.time[0] == 0.0
    # Where the window has their numbers, nothing needs to be said.
    edit(
        decay_case,
        ('zero = "first"\n', ""),
        ("window_s = [0, 64800]", "window_s = [1700000000, 1700064800]"),
    )
    assert load_case(decay_case).scenario.time_communication[0] == 1_700_000_000


def test_inputs_that_begin_after_the_simulation_are_refused(decay_case: Path):
    split(decay_case)
    inputs = decay_case / "data" / "recording.csv"
    inputs.write_text(re.sub(r"(?m)^(0|1800|3600),.*\n", "", inputs.read_text()))
    with pytest.raises(
        InputError, match=r"covers 5400 to 86400 s, the simulation needs 0 to 64800 s"
    ) as error:
        load_case(decay_case)
    assert "begin the simulation later, or record from its begin on" in str(error.value)
    assert 'zero = "first"' in str(error.value)
    edit(decay_case, ("window_s = [0, 64800]", "window_s = [5400, 64800]"))
    case = load_case(decay_case)
    assert case.scenario.time_communication[0] == 5400
    assert case.measurement.outputs[0].samples.time[0] == 9000


def test_other_inputs_follow_the_same_zero(decay_case: Path):
    split(decay_case, first_s=0, shift_s=1_700_000_000)
    edit(decay_case, ("[time]", '[time]\nzero = "first"'))
    case = load_case(decay_case)
    other = settings_with_inputs(case, decay_case / "data" / "recording.csv")
    assert other.scenario.time_communication[[0, -1]].tolist() == [0.0, 86400.0]


@pytest.mark.parametrize(
    ("zero", "said"),
    [
        ("2018-01-01", 'have a zero; drop the key, or write zero = "first" to count from the first row'),
        ("last", 'is no timestamp; write for instance "2018-01-01T00:00", or "first" for the first row'),
    ],
)
def test_another_zero_of_seconds_is_refused(decay_case: Path, zero: str, said: str):
    edit(decay_case, ("[time]", f'[time]\nzero = "{zero}"'))
    with pytest.raises(InputError, match=re.escape(said)):
        load_case(decay_case)


def test_first_is_the_rule_of_timestamps(decay_case: Path):
    lines = (decay_case / "data" / "recording.csv").read_text().splitlines()[1:]
    rows = [
        f"2024-03-{1 + i // 48:02d} {i // 2 % 24:02d}:{i % 2 * 30:02d},{one.partition(',')[2]}"
        for i, one in enumerate(lines)
    ]
    before = load_case(decay_case).digest
    (decay_case / "data" / "recording.csv").write_text("\n".join(["time,T_degC,heating", *rows]) + "\n")
    assert load_case(decay_case).digest == before
    edit(decay_case, ("[time]", '[time]\nzero = "first"'))
    assert load_case(decay_case).digest == before
