"""Wrong inputs: each one clear line, exit code 2, no traceback, nothing written."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from project_for_tests import Answer, Run, edit

from simulation.errors import InputError
from studies.cli import is_interrupt
from studies.profile import PROFILE_FOLDER
from studies.results.saved import read_arrays

CASE = "fmus/office/case.toml"
RECORDING = "data/office/recording_1800s.csv"


def assert_refused(answer: Answer, *fragments: str) -> None:
    """Check that an answer is one clear line that names what is wrong."""
    assert answer.code == 2, answer.err
    lines = answer.err.splitlines()
    assert len(lines) == 1, answer.err
    assert lines[0].startswith("studies: error: ")
    for fragment in fragments:
        assert fragment in lines[0]
    assert answer.out == ""


@pytest.fixture
def project(new_project: Path) -> Path:
    """Nothing was made yet, and what is refused makes nothing."""
    return new_project


def files_of(project: Path) -> dict[str, int]:
    return {str(file.relative_to(project)): file.stat().st_mtime_ns for file in project.rglob("*")}


# Every mistake that a case file or a recording can have: tests/simulation/test_wrong_inputs.py.
@pytest.mark.parametrize(
    ("command", "file", "old", "new", "fragments"),
    [
        ("check", CASE, 'fmu = "Office.fmu"', 'fmu = "Offfice.fmu"', ["Offfice.fmu"]),
        ("check", CASE, 'unit = "W/(m2.K)"', 'unit = "W/K"', ["UWin", "W/K", "W/(m2.K)"]),
        ("simulate", RECORDING, "TEnv_degC", "TEnv", ["recording_1800s.csv", "TEnv_degC is missing"]),
    ],
)
def test_a_wrong_case_file_or_recording_is_refused(
    project: Path, studies: Run, command: str, file: str, old: str, new: str, fragments: list[str]
) -> None:
    edit(project / file, (old, new))
    before = files_of(project)
    assert_refused(studies(command), *fragments)
    assert files_of(project) == before


def test_an_fmu_with_a_damaged_binary_is_refused(project: Path, studies: Run) -> None:
    fmu = project / "fmus" / "office" / "Office.fmu"
    content = bytearray(fmu.read_bytes())
    with zipfile.ZipFile(fmu) as archive:
        binary = next(member for member in archive.infolist() if member.filename.startswith("binaries/linux"))
    middle = binary.header_offset + binary.compress_size // 2
    content[middle : middle + 200] = bytes(byte ^ 0x55 for byte in content[middle : middle + 200])
    fmu.write_bytes(content)
    # Its description is whole, so the doctor examines it; whatever simulates refuses it.
    answer = studies("check", "--json")
    assert answer.code == 1
    found = answer.document["findings"][-1]
    assert (found["what"], found["remedy"]) == ("opening the FMU", "export it again")
    assert "unpacked" in found["found"]
    answer = studies("simulate")
    assert answer.code == 2
    assert answer.err.splitlines()[-1].startswith("studies: error: ")
    assert "Office.fmu: cannot be unpacked" in answer.err
    assert "Traceback" not in answer.err


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        pytest.param(["check", "ofice"], ["ofice", "did you mean 'office'"], id="case-name"),
        pytest.param(
            ["simulate", "--window", "0-99"],
            ["error: --window 0-99: ", "case.toml: days 0 to 99: the recording ", "shorten the window"],
            id="window-beyond-the-data",
        ),
        pytest.param(["run", "--seed", "4294967296"], ["--seed", "4294967295 at most"], id="seed-too-large"),
        pytest.param(
            ["calibrate", "--method", "paper"], ["no surrogate", "studies tune office"], id="nothing-tuned"
        ),
        pytest.param(
            ["calibrate", "--method", "adaptive", "--n-train", "64"],
            ["--n-train belongs to --method paper"],
            id="sizes-without-a-surrogate",
        ),
        pytest.param(
            ["calibrate", "--max-calls", "4"],
            ["must be at least 5: with 14 parameters the search begins with 5"],
            id="too-few-calls",
        ),
        pytest.param(
            ["calibrate", "--no-state-equations", "--max-calls", "13"],
            ["must be at least 14: with 14 parameters the search begins with 14"],
            id="too-few-calls-for-the-design",
        ),
        pytest.param(
            ["calibrate", "--parallel", "2", "--n-train", "64"],
            ["--parallel belongs to --method adaptive"],
            id="parallel-without-rounds",
        ),
        pytest.param(["calibrate", "--method", "genetic"], ["invalid choice: 'genetic'"], id="method"),
        pytest.param(
            ["predict", "--inputs", RECORDING], ["type: studies calibrate office"], id="nothing-to-predict"
        ),
        pytest.param(["report"], ["no calibration", "studies calibrate office"], id="nothing-to-report"),
        pytest.param(["ui"], ["mlflow.db", "studies run"], id="no-store"),
        pytest.param(["frobnicate"], ["frobnicate"], id="command"),
        pytest.param(["check", "--frobnicate"], ["--frobnicate"], id="option"),
        pytest.param(["import-recording", "gone.mat"], ["gone.mat"], id="recording-missing"),
    ],
)
def test_wrong_options_are_refused(
    project: Path, studies: Run, arguments: list[str], fragments: list[str]
) -> None:
    before = files_of(project)
    assert_refused(studies(*arguments), *fragments)
    assert files_of(project) == before


def test_a_gpu_that_is_not_there_is_refused(project: Path, studies: Run) -> None:
    import torch

    if torch.cuda.is_available():
        pytest.skip("there is a CUDA device here")
    profile = (PROFILE_FOLDER / "smoke.toml").read_text(encoding="utf-8")
    (project / "cuda.toml").write_text(profile.replace("[tuning]", '[tuning]\ndevice = "cuda"'))
    assert_refused(studies("tune", "--quiet", "--profile", "cuda.toml"), "tuning.device", "'auto' or 'cpu'")


def test_a_damaged_calibration_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "calibrate-n0064.npz"
    np.save(file.with_suffix(".npy"), np.zeros(3))
    for content in (b"no archive" * 100, file.with_suffix(".npy").read_bytes()):
        file.write_bytes(content)
        with pytest.raises(InputError, match=r"npz is damaged; remove it and repeat its command"):
            read_arrays(file)


def fail_while_interrupted() -> None:
    try:
        raise KeyboardInterrupt
    finally:
        raise ValueError("half written")


def test_an_error_that_a_ctrl_c_led_to_is_distinguished_from_others() -> None:
    with pytest.raises(ValueError, match="half written") as found:
        fail_while_interrupted()
    assert is_interrupt(found.value)
    assert is_interrupt(KeyboardInterrupt())
    assert not is_interrupt(ValueError("half written"))
    assert not is_interrupt(None)


@pytest.mark.parametrize("command", ["status", "best"])
def test_a_damaged_database_is_refused(project: Path, studies: Run, command: str) -> None:
    (project / "mlruns").mkdir()
    (project / "mlruns" / "optuna.db").write_bytes(b"no database" * 500)
    assert_refused(studies(command), "Optuna cannot open mlruns/optuna.db", "not a database")
