"""Recordings as loggers write them: own times, gaps, other separators, timestamps, clocks set back."""

import re
import tracemalloc
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from case_for_tests import edit

from simulation import InputError, load_case
from simulation.recording import read_recording

DAY = 86400


def write(folder: Path, name: str, header: str, rows: list[str], encoding: str = "utf-8") -> None:
    (folder / "data" / name).write_bytes(("\n".join([header, *rows]) + "\n").encode(encoding))


def own_file(folder: Path, rows: list[str], header: str = "time_s,T_degC") -> None:
    """Give the output a file of its own; the input keeps the old one."""
    write(folder, "room.csv", header, rows)
    edit(folder, ('file = "recording.csv"\ncolumn = "T_degC"', 'file = "room.csv"\ncolumn = "T_degC"'))


def test_an_output_is_compared_at_its_own_uneven_times(decay_case: Path):
    # The window is from 21600 to 64800 s.
    times = [0, 20000, 21599, 21600, 22222, 30000, 30001, 64800, 64801, 90000]
    own_file(decay_case, [f"{t},{20 + t / 1e5}" for t in times])
    measurement = load_case(decay_case).measurement
    assert measurement.outputs[0].samples.time.tolist() == [21600, 22222, 30000, 30001, 64800]
    np.testing.assert_array_equal(
        measurement.outputs[0].samples.values, [float(f"{20 + t / 1e5}") for t in times[3:8]]
    )
    assert np.flatnonzero(~np.isnan(measurement.y[:, 0])).tolist() == [0, 24]


@pytest.mark.parametrize("empty", ["", "NaN", "nan", " ", "NA", "n/a", "null"])
def test_an_empty_cell_of_an_output_is_a_gap(decay_case: Path, empty: str):
    before = load_case(decay_case).measurement
    path = decay_case / "data" / "recording.csv"
    path.write_text(re.sub(r"(?m)^36000,[^,]*,", f"36000,{empty},", path.read_text()))
    after = load_case(decay_case).measurement
    assert after.n_samples == before.n_samples - 1
    assert np.flatnonzero(np.isnan(after.y[:, 0])).tolist() == [8]
    rows = np.random.default_rng(0).normal(20, 1, (3, 25, 1))
    kept = np.arange(25) != 8
    np.testing.assert_array_equal(after.compared(rows), before.compared(rows)[:, kept])


def test_an_input_may_bridge_a_gap_that_is_declared(decay_case: Path):
    path = decay_case / "data" / "recording.csv"
    full = load_case(decay_case).scenario.inputs
    path.write_text(re.sub(r"(?m)^36000,.*\n", "", path.read_text()))
    edit(decay_case, ('"linear"', '"linear"\nmax_gap_s = 3600'))
    bridged = load_case(decay_case)
    # Only the six steps of the hour around the missing sample can differ, and the output lost a sample.
    differs = np.flatnonzero(np.abs(bridged.scenario.inputs - full)[:, 0] > 1e-12)
    assert differs.min() >= 21
    assert differs.max() <= 26
    assert bridged.measurement.n_samples == 24


def test_a_german_export_is_read(decay_case: Path):
    before = load_case(decay_case)
    path = decay_case / "data" / "recording.csv"
    text = path.read_text().replace(",", ";").replace(".", ",").replace("T_degC", "T_°C")
    path.write_bytes(text.encode("cp1252"))
    edit(decay_case, ('column = "T_degC"', 'column = "T_°C"'))
    after = load_case(decay_case)
    assert after.digest == before.digest
    assert after.measurement.digest == before.measurement.digest


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_tabs_and_other_encodings_are_read(decay_case: Path, encoding: str):
    before = load_case(decay_case)
    path = decay_case / "data" / "recording.csv"
    path.write_bytes(path.read_text().replace(",", "\t").encode(encoding))
    assert load_case(decay_case).measurement.digest == before.measurement.digest


START = datetime(2018, 2, 21)
CHANGE = datetime(2018, 3, 25, 2)


def stamped(folder: Path, stamps: list[str], header: str = "time,T_degC,heating") -> None:
    """Give the recording's 49 half-hourly rows timestamps."""
    lines = (folder / "data" / "recording.csv").read_text().splitlines()[1:]
    rows = [",".join([stamp, *line.split(",")[1:]]) for stamp, line in zip(stamps, lines, strict=True)]
    write(folder, "recording.csv", header, rows)


@pytest.mark.parametrize(
    "form",
    [
        "%Y-%m-%d %H:%M",
        "%Y-%m-%dT%H:%M:%S",
        "%Y-%m-%dT%H:%M:%SZ",
        "%d.%m.%Y %H:%M",
        "%Y-%m-%d %H:%M:%S+01:00",
    ],
)
def test_timestamps_count_from_the_first_row(decay_case: Path, form: str):
    before = load_case(decay_case)
    stamped(decay_case, [(START + timedelta(minutes=30 * i)).strftime(form) for i in range(49)])
    after = load_case(decay_case)
    assert after.digest == before.digest
    assert after.measurement.digest == before.measurement.digest


def test_the_model_s_time_zero_can_be_declared(decay_case: Path):
    stamped(decay_case, [(START + timedelta(minutes=30 * i)).isoformat() for i in range(49)])
    edit(
        decay_case,
        ("[time]\nwindow_d = [0.25, 0.75]", '[time]\nwindow_d = [51.25, 51.75]\nzero = "2018-01-01"'),
    )
    quoted = load_case(decay_case)
    edit(decay_case, ('zero = "2018-01-01"', "zero = 2018-01-01"))
    case = load_case(decay_case)
    assert case.digest == quoted.digest
    assert case.scenario.time_communication[0] == 51.25 * DAY
    assert case.measurement.n_samples == 25


def test_what_a_clock_change_makes_of_a_clock_is_reported(decay_case: Path):
    # Clocks in Berlin went forward on 25 March 2018 at 02:00.
    begin = datetime(2018, 3, 24, 18)
    never_shifted = [(begin + timedelta(minutes=30 * i)).isoformat() for i in range(49)]
    shifted = [
        (begin + timedelta(minutes=30 * i, hours=begin + timedelta(minutes=30 * i) >= CHANGE)).isoformat()
        for i in range(49)
    ]
    edit(decay_case, ("window_d = [0.25, 0.75]", "window_d = [0.125, 0.875]"))
    stamped(decay_case, shifted)
    with pytest.raises(InputError, match=r"= 5400 for .*; if it is the change to summer time, write"):
        load_case(decay_case)
    edit(decay_case, ("schema = 1", 'schema = 1\ntimezone = "Europe/Berlin"'))
    load_case(decay_case)
    stamped(decay_case, shifted[:1] + never_shifted[1:])
    with pytest.raises(InputError, match=r"no summer time, remove timezone = "):
        load_case(decay_case)
    # A row twice is no clock's fault.
    stamped(decay_case, [*shifted[:5], *shifted[4:-1]])
    with pytest.raises(
        InputError,
        match=r"repeats the line above .* drop duplicates, or give replicates a column each$",
    ):
        load_case(decay_case)


SECRET = "machine example.org login me password s3cret"


@pytest.mark.parametrize("how", ["named", "linked"])
@pytest.mark.parametrize("content", [f"{SECRET}\n", f"time_s,T_degC\n0,1\n3600,{SECRET}\n"])
def test_what_a_file_outside_the_project_holds_is_not_quoted(
    decay_case: Path, tmp_path_factory: pytest.TempPathFactory, content: str, how: str
):
    secret = tmp_path_factory.mktemp("home") / ".netrc"
    secret.write_text(content)
    place = secret
    if how == "linked":
        place = decay_case / "data" / "room.csv"
        place.symlink_to(secret)
    edit(decay_case, ('file = "recording.csv"\ncolumn = "T_degC"', f'file = "{place}"\ncolumn = "T_degC"'))
    with pytest.raises(
        InputError, match=r"outside the project of its case.*STUDIES_FOLLOW_LINKS=1"
    ) as caught:
        load_case(decay_case)
    assert "s3cret" not in str(caught.value)
    assert str(secret) in str(caught.value)


def test_what_the_user_allows_is_quoted(decay_case: Path, monkeypatch: pytest.MonkeyPatch):
    edit(decay_case, ('data = "data"', 'data = "/proc/self"'), ('file = "recording.csv"', 'file = "status"'))
    with pytest.raises(InputError, match="outside the project"):
        load_case(decay_case)
    monkeypatch.setenv("STUDIES_FOLLOW_LINKS", "1")
    with pytest.raises(InputError, match="found Name:"):
        load_case(decay_case)


@pytest.mark.parametrize("blank", ["", ","])
@pytest.mark.parametrize("is_at_end", [True, False])
def test_blank_lines_take_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, blank: str, *, is_at_end: bool
):
    n_bytes = 200_000
    monkeypatch.setenv("STUDIES_LIMITS", "0.005")  # as much is read at once, 64 MB without it
    blanks = f"{blank}\n" * (n_bytes // (len(blank) + 1))
    file = tmp_path / "x.csv"
    file.write_text("time_s,a\n0,1\n1,2\n" + blanks + ("" if is_at_end else "2,3\n"))
    tracemalloc.start()
    if is_at_end:
        assert len(read_recording(file, ["a"]).time) == 2
    else:
        with pytest.raises(InputError, match="line 4"):
            read_recording(file, ["a"])
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    # The bytes, their text, and that text as csv reads it, at four bytes a character; a row takes 56 more.
    assert most < 10 * n_bytes
