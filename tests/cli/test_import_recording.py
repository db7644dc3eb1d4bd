"""Importing a recording from each form it is published in, and refusing what is not one."""

import os
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from made_up_recording import Array, made_up_recording, write_csv_files
from project_for_tests import Run
from scipy.io import savemat

BESIDE = Path(__file__).resolve().parents[3] / "shared" / "data" / "office_recording"
SHARED = Path(os.environ.get("OFFICE_RECORDING", BESIDE))
needs_recording = pytest.mark.skipif(
    not (SHARED / "recording_1800s.csv").is_file(),
    reason="the paper's recording is not ours to ship; set OFFICE_RECORDING to its folder",
)
Recording = dict[str, tuple[Array, Array]]


def write_matlab(file: Path, recording: Recording, *, version: str = "5", transposed: bool = False) -> Path:
    tables = {name: np.column_stack(columns) for name, columns in recording.items()}
    if transposed:
        tables = {name: table.T for name, table in tables.items()}
    savemat(file, tables, format=version)
    return file


def imported(project: Path) -> tuple[str, str]:
    folder = project / "data" / "office-recorded"
    return (folder / "recording_1800s.csv").read_text(), (folder / "occupancy_600s.csv").read_text()


@pytest.fixture
def expected(tmp_path: Path) -> tuple[str, str]:
    write_csv_files(tmp_path / "expected")
    folder = tmp_path / "expected"
    return (folder / "recording_1800s.csv").read_text(), (folder / "occupancy_600s.csv").read_text()


@pytest.mark.parametrize(("version", "transposed"), [("4", False), ("5", True)])
def test_a_matlab_file_becomes_the_two_csv_files(
    project: Path, studies: Run, tmp_path: Path, expected: tuple[str, str], version: str, transposed: bool
) -> None:
    file = write_matlab(tmp_path / "data.mat", made_up_recording(), version=version, transposed=transposed)
    answer = studies("import-recording", str(file), "--json")
    assert answer.code == 0, answer.err
    assert answer.document["n_rows"] == [1056, 3168]
    assert answer.document["files"] == [
        "data/office-recorded/recording_1800s.csv",
        "data/office-recorded/occupancy_600s.csv",
    ]
    assert imported(project) == expected


def test_the_fmu_that_holds_the_recording_is_read(
    project: Path, studies: Run, tmp_path: Path, expected: tuple[str, str]
) -> None:
    file = write_matlab(tmp_path / "data.mat", made_up_recording())
    with zipfile.ZipFile(tmp_path / "Office.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", "<fmiModelDescription/>")
        archive.write(file, "resources/identification_data.mat")
    answer = studies("import-recording", str(tmp_path / "Office.fmu"))
    assert answer.code == 0, answer.err
    assert "resources/identification_data.mat" in answer.out
    assert imported(project) == expected


def shorten(recording: Recording) -> None:
    for name, (time, values) in recording.items():
        rows = slice(0, 48 * 9 * (3 if name == "Occupancy" else 1))
        recording[name] = (time[rows], values[rows])


def make_gap(recording: Recording) -> None:
    time, values = recording["IrrGH"]
    recording["IrrGH"] = (np.delete(time, 20), np.delete(values, 20))


def use_kelvin(recording: Recording) -> None:
    time, values = recording["TRoom"]
    recording["TRoom"] = (time, values + 273.15)


@pytest.mark.parametrize(
    ("spoil", "fragments"),
    [
        (shorten, ["days", "10"]),
        (make_gap, ["IrrGH", "37800", "1800", "36000"]),
        (use_kelvin, ["TRoom_degC", "unit"]),
    ],
)
def test_a_wrong_recording_is_refused_and_nothing_written(
    project: Path, studies: Run, tmp_path: Path, spoil: Callable[[Recording], None], fragments: list[str]
) -> None:
    recording = made_up_recording()
    spoil(recording)
    answer = studies("import-recording", str(write_matlab(tmp_path / "data.mat", recording)))
    assert answer.code == 2, answer.out
    (line,) = answer.err.splitlines()
    for fragment in fragments:
        assert fragment in line
    assert not (project / "data" / "office-recorded").exists()


@pytest.mark.parametrize(
    ("name", "content", "fragment"),
    [
        ("data.mat", b"not MATLAB at all" * 20, "MATLAB"),
        ("Office.fmu", b"not a zip", "no FMU"),
        ("recording_1800s.csv", b"time_s,TRoom_degC\n0,1\n1800,2\n", "no MATLAB file"),
    ],
)
def test_a_file_of_another_kind_is_refused(
    project: Path, studies: Run, tmp_path: Path, name: str, content: bytes, fragment: str
) -> None:
    (tmp_path / name).write_bytes(content)
    answer = studies("import-recording", str(tmp_path / name))
    assert answer.code == 2
    (line,) = answer.err.splitlines()
    assert fragment in line
    assert not (project / "data" / "office-recorded").exists()


@needs_recording
def test_the_papers_recording_is_taken_over_to_the_last_digit(project: Path, studies: Run) -> None:
    assert studies("import-recording", str(SHARED)).code == 0
    assert imported(project) == tuple(
        (SHARED / name).read_text() for name in ("recording_1800s.csv", "occupancy_600s.csv")
    )
