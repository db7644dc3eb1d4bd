"""`studies reproduce`: results made again to the last digit, and what is said where they cannot be."""

import json
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from project_for_tests import Run, add_case, copy_of

from studies.cli import main
from studies.paths import ProjectPaths
from studies.reproduction import compare
from studies.tracking.quiet_mlflow import connect

LABEL, ADAPTIVE = "office-smoke", "wall-smoke/adaptive"
WALL = Path("fmus") / "wall"


@pytest.fixture(scope="module")
def made(whole_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in which something of every kind was made."""
    with pytest.MonkeyPatch.context() as patch:
        root = copy_of(whole_run, tmp_path_factory.mktemp("made") / "project", patch)
        add_case(root)
        assert main(["calibrate", "wall", "--profile", "smoke", "--quiet", "--max-calls", "8"]) == 0
    return root


@pytest.fixture
def copied(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """That project at another place, as a test may spoil it."""
    return copy_of(made, tmp_path / "moved", monkeypatch)


def runs_of(root: Path, role: str) -> list[str]:
    """Return the ids of the runs of a kind."""
    client = connect(ProjectPaths(root).tracking_uri)
    experiments = [one.experiment_id for one in client.search_experiments()]
    found = client.search_runs(experiments, f"tags.role = '{role}'")
    return [run.info.run_id for run in found]


def record_file(root: Path, run: str) -> Path:
    (file,) = root.glob(f"mlruns/artifacts/*/{run}/artifacts/provenance.json")
    return file


def record_of(root: Path, run: str) -> dict[str, Any]:
    content = json.loads(record_file(root, run).read_text(encoding="utf-8"))
    content.pop("checksum")
    assert isinstance(content, dict)
    return content


def files_below(root: Path) -> dict[str, int]:
    """Return every file that holds a result, with the time of its last change."""
    places = [root / "data", *(root / "mlruns" / name for name in ("results", "artifacts", "reports"))]
    files = (file for place in places for file in place.rglob("*") if file.is_file())
    return {str(file): file.stat().st_mtime_ns for file in files if not file.name.startswith(".")}


def test_what_mlflow_recorded_is_made_again_to_the_last_digit(copied: Path, studies: Run) -> None:
    size = next(one for one in studies("best", "--json").document["sizes"] if one["parts"])
    mean, trial = size["run_id"], next(part["run_id"] for part in size["parts"])
    # What else the project holds is not needed.
    shutil.rmtree(copied / "mlruns" / "results")
    for case in ("office", "wall"):
        shutil.rmtree(copied / "data" / case / "generated")
    (copied / "mlruns" / "optuna.db").unlink()
    for what in (f"{LABEL}/n0016", ADAPTIVE, trial, mean):
        before = files_below(copied)
        answer = studies("reproduce", what, "--json")
        assert answer.code == 0, answer.out + answer.err
        assert answer.document["equal"]
        rows = {row["name"]: row for row in answer.document["numbers"]}
        if what in (mean, trial):
            mae = size["mae"] if what == mean else size["parts"][0]["metrics"]["test/mae"]
            assert rows["test/mae"]["recorded"] == rows["test/mae"]["now"] == repr(mae)
            assert ("share/1" if what == mean else "curve/validation_mae") in rows
        else:
            assert {"theta.GIn" if what == ADAPTIVE else "theta.UWin", "ledger.total_calls"} <= rows.keys()
            assert files_below(copied) == before
            assert answer.document["run"] in runs_of(copied, "calibration")


@pytest.mark.slow
def test_the_run_of_the_stored_result_is_made_again_whatever_a_clock_says(copied: Path, studies: Run) -> None:
    before = {*runs_of(copied, "calibration")}
    assert studies("calibrate", "wall", "--profile", "smoke", "-q", "--max-calls", "9").code == 0
    (last,) = {*runs_of(copied, "calibration")} - before
    # As if the clock had been set back meanwhile.
    with closing(sqlite3.connect(copied / "mlruns" / "mlflow.db")) as store, store:
        store.execute("update runs set start_time = start_time - 3600000 where run_uuid = ?", (last,))
    assert studies("reproduce", ADAPTIVE, "--json").document["run"] == last


def test_a_number_that_is_not_what_was_recorded_is_shown(copied: Path, studies: Run) -> None:
    run = next(run for run in runs_of(copied, "calibration") if "adaptive" in record_of(copied, run)["kind"])
    record = record_of(copied, run)
    record["result"]["mse"] *= 1.0 + 1e-12
    record_file(copied, run).write_text(json.dumps(record), encoding="utf-8")
    answer = studies("reproduce", ADAPTIVE)
    assert answer.code == 1
    (line,) = [line for line in answer.out.splitlines() if "DIFFERS" in line]
    assert line.split()[0] == "mse"
    assert "1.0e-12" in line
    assert "differs: 1 of " in answer.out


def changed_case(root: Path) -> None:
    file = root / WALL / "case.toml"
    file.write_text(file.read_text(encoding="utf-8") + "# another thought\n", encoding="utf-8")


def changed_recording(root: Path) -> None:
    file = root / "data" / "wall" / "measured.csv"
    lines = file.read_text(encoding="utf-8").splitlines()
    within = len(lines) // 2
    cells = lines[within].split(",")
    lines[within] = ",".join([cells[0], f"{float(cells[1]) + 1.0}", *cells[2:]])
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")


def changed_fmu(root: Path) -> None:
    with (root / WALL / "Wall.fmu").open("ab") as file:
        file.write(b"\0")


def lost_fmu(root: Path) -> None:
    (root / WALL / "Wall.fmu").unlink()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (changed_case, "fmus/wall/case.toml: the file itself changed since 'studies calibrate wall"),
        (changed_recording, "; restore it, or repeat that command"),
        (changed_fmu, "fmus/wall/case.toml: its FMU or its inputs changed since 'studies calibrate wall"),
        (lost_fmu, "Wall.fmu"),
    ],
)
def test_what_was_changed_since_is_one_line(copied: Path, studies: Run, change: Any, said: str) -> None:
    change(copied)
    before = files_below(copied)
    answer = studies("reproduce", ADAPTIVE, "--json")
    assert answer.code == 2
    assert said in answer.document["error"]
    assert files_below(copied) == before


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("office-smoke/n0077", "nothing is called 'office-smoke/n0077'"),
        ("office-smoke", "nothing is called"),
        ("0123456789abcdef0123456789abcdef", "nothing is called"),
        ("study", "provenance.json"),
        ("sensitivity", "'sensitivity'"),
    ],
)
def test_what_cannot_be_made_again_is_one_line(
    made: Path, studies: Run, what: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(made)
    (run, *_) = [*runs_of(made, what), what]
    answer = studies("reproduce", run, "--json")
    assert answer.code == 2
    assert said in answer.document["error"]
    assert len(answer.err.splitlines()) == 1


def test_a_damaged_record_of_a_run_is_one_line_at_the_terminal(copied: Path, studies: Run) -> None:
    (run, *_) = runs_of(copied, "trial")
    file, record = record_file(copied, run), record_of(copied, run)
    for change, said in (
        ({"schema": [None]}, "of schema [None]"),
        ({"window_d": [[], 2]}, "window_d.0 = []"),
        ({"params": "../../x"}, "params = '../../x'"),
        ({"params": {"n_hidden": -1}}, "n_hidden = -1 must be at least 1"),
        ({"declaration": None}, "declaration is missing"),
    ):
        file.write_text(json.dumps(record | change), encoding="utf-8")
        answer = studies("reproduce", run, "--json")
        assert answer.code == 2
        assert said in answer.document["error"]
        assert len(answer.err.splitlines()) == 1


@pytest.mark.parametrize(
    ("recorded", "now", "is_equal", "relative"),
    [
        (1.0, 1.0, True, 0.0),
        (1.0, np.nextafter(1.0, 2.0), False, 2.220446049250313e-16),
        (1.0, None, False, None),
        ("pruned", "pruned", True, None),
        ([1.0, 2.0], [1.0, 2.5], False, 0.25),
        ([1.0, float("nan")], [1.0, float("nan")], True, 0.0),
    ],
)
def test_numbers_are_compared_to_the_last_digit(
    recorded: Any, now: Any, is_equal: bool, relative: float | None
) -> None:
    (row,) = compare({"x": recorded}, {"x": now})
    assert (row.is_equal, row.relative) == (is_equal, relative)
