"""`studies reproduce`: results made again to the last digit, and what is said where they cannot be."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from project_for_tests import Run, make_project

from studies.cli import main
from studies.lineage import lineage_of
from studies.paths import ProjectPaths
from studies.reproduction.comparison import aligned, compare

PROFILE = """\
schema = 1
name = "small"
[data]
n_train = [16]
n_validation = 32
n_test = 32
[sensitivity]
n_base = 4
n_resamples = 10
[tuning]
n_trials = 8
variant = "refined"
max_epochs = 60
patience = 60
[tuning.search]
n_latent = [4, 8]
n_hidden = [8, 32]
beta = [10.0, 100.0]
learning_rate = [0.002, 50.0]
[screening]
popsize = 4
maxiter = 10
[polish]
max_calls = 40
"""
STUDY = ("office", "--profile", "small.toml", "--quiet")
LABEL = "office-small"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in which something of every kind was made."""
    root = make_project(tmp_path_factory.mktemp("made") / "project")
    (root / "small.toml").write_text(PROFILE, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STUDIES_ROOT", str(root))
        patch.chdir(root)
        assert main(["tune", *STUDY]) == 0
        assert main(["calibrate", *STUDY, "--method", "paper"]) == 0
        assert main(["calibrate", *STUDY, "--max-calls", "35"]) == 0
        assert main(["uncertainty", *STUDY, "--max-calls", "44"]) == 0
        assert main(["sensitivity", *STUDY]) == 0
    return root


@pytest.fixture
def copied(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """That project at another place, as a test may spoil it."""
    root = tmp_path / "elsewhere"
    shutil.copytree(made, root)
    monkeypatch.setenv("STUDIES_ROOT", str(root))
    monkeypatch.chdir(root)
    return root


def trials(root: Path) -> dict[str, str]:
    """Return one trial of each state, by its name."""
    found = {}
    for file in sorted((root / "mlruns" / "trials").glob("*/*/t*/trial.json")):
        record = json.loads(file.read_text())
        found[record["state"]] = f"{record['study']}/{file.parent.name}"
    return found


def files_below(root: Path) -> dict[str, int]:
    """Return every file that holds a result, with the time of its last change."""
    places = [root / "data", *(root / "mlruns" / name for name in ("trials", "results", "champions"))]
    files = (file for place in places for file in place.rglob("*") if file.is_file())
    return {str(file): file.stat().st_mtime_ns for file in files if not file.name.startswith(".")}


@pytest.mark.parametrize("state", ["complete", "pruned", "failed"])
def test_a_trial_is_made_again_to_the_last_digit(copied: Path, studies: Run, state: str) -> None:
    before = files_below(copied)
    answer = studies("reproduce", trials(copied)[state], "--json")
    assert answer.code == 0, answer.out
    assert answer.document["equal"]
    rows = {row["name"]: row for row in answer.document["numbers"]}
    assert rows["state"]["now"] == state
    assert ("weights" in rows) == (state == "complete")
    assert "equal numbers are expected" in answer.document["expectation"]
    assert files_below(copied) == before


@pytest.mark.parametrize("what", ["n0016 calibration", "adaptive", "adaptive uncertainty", "sensitivity"])
def test_a_stage_is_made_again_to_the_last_digit(copied: Path, studies: Run, what: str) -> None:
    answer = studies("reproduce", f"{LABEL}/{what}", "--json")
    assert answer.code == 0, answer.out
    assert len(answer.document["numbers"]) > 20


def test_what_mlflow_recorded_is_enough_where_everything_else_is_lost(copied: Path, studies: Run) -> None:
    from studies.tracking.quiet_mlflow import connect

    paths = ProjectPaths(copied)
    client = connect(paths.tracking_uri)
    experiment = client.get_experiment_by_name(LABEL)
    assert experiment is not None
    for name in ("trials", "results", "champions"):
        shutil.rmtree(copied / "mlruns" / name)
    shutil.rmtree(copied / "data" / "office" / "generated")
    shutil.rmtree(copied / "mlruns" / "artifacts")
    for wanted in ("tags.state = 'pruned'", "tags.role = 'calibration' and params.n_train = '16'"):
        run = client.search_runs([experiment.experiment_id], wanted, max_results=1)[0].info.run_id
        answer = studies("reproduce", run[:10], "--json")
        assert answer.code == 0, answer.out + answer.err
        assert answer.document["recorded_in"] == f"MLflow, run {run}"
        assert any("simulated again they are the recorded ones" in note for note in answer.document["notes"])
    assert any("it is trained again" in note for note in answer.document["notes"])


def test_what_was_changed_since_is_named_and_does_no_harm(copied: Path, studies: Run) -> None:
    case = copied / "fmus" / "office" / "case.toml"
    case.write_text(case.read_text().replace("upper = 3.5\n", "upper = 3.6\n"))
    profile = copied / "small.toml"
    profile.write_text(PROFILE.replace("max_epochs = 60", "max_epochs = 61"))
    recording = copied / "data" / "office" / "occupancy_600s.csv"
    shutil.copy(recording, recording.with_name("kept.csv"))
    recording.write_text(recording.read_text() + "garbage")
    answer = studies("reproduce", trials(copied)["complete"], "--json")
    assert answer.code == 0, answer.out
    named = {one["key"]: one for one in answer.document["differences"]}
    assert named["case file fmus/office/case.toml"]["detail"] == ["-upper = 3.5", "+upper = 3.6"]
    assert (named["profile small.toml: tuning.max_epochs"]["now"]) == "61"
    assert named["inputs data/office/occupancy_600s.csv"]["now"] == "changed"
    assert not any(one["is_decisive"] for one in named.values())
    assert any("kept.csv has the recorded content" in note for note in answer.document["notes"])


def test_a_number_that_is_not_what_was_recorded_is_shown(copied: Path, studies: Run) -> None:
    name = trials(copied)["complete"]
    file = next(copied.glob(f"mlruns/trials/*/*/{name.rpartition('/')[2]}/trial.json"))
    record = json.loads(file.read_text())
    record["metrics"]["test/mae"] *= 1.0 + 1e-12
    record["environment"]["torch"] = "1.0"
    file.write_text(json.dumps(record))
    answer = studies("reproduce", name)
    assert answer.code == 1
    (line,) = [line for line in answer.out.splitlines() if "DIFFERS" in line]
    assert line.split()[0] == "test/mae"
    assert "1.0e-12" in line
    assert "! torch: 1.0 -> " in answer.err
    assert "because of: torch" in answer.out


def test_an_fmu_that_is_nowhere_is_one_line(copied: Path, studies: Run) -> None:
    (copied / "fmus" / "office" / "Office.fmu").unlink()
    answer = studies("reproduce", f"{LABEL}/n0016", "--json")
    assert answer.code == 2
    assert answer.document["error"].startswith("fmus/office/Office.fmu is missing and no file below fmus/")
    assert "sha256" in answer.document["error"]


@pytest.mark.parametrize(
    ("run", "said"),
    [
        ("office-small/n0016/t077", "nothing is called"),
        ("0123456789", "nothing is called"),
        ("office-small/simulate", "can be made again"),
    ],
)
def test_what_cannot_be_made_again_is_one_line(copied: Path, studies: Run, run: str, said: str) -> None:
    answer = studies("reproduce", run, "--json")
    assert answer.code == 2
    assert said in answer.document["error"]


def test_the_way_up_and_down_names_every_step_and_what_became_of_it(copied: Path, studies: Run) -> None:
    paths = ProjectPaths(copied)
    found = lineage_of(paths, f"{LABEL}/calibrate-n0016")
    kinds = [step.kind for step in found.made_from]
    assert kinds[:4] == ["model", "trial", "study", "rows"]
    assert {"case", "FMU", "recording"} < set(kinds)
    assert {step.state for step in found.made_from} == {"unchanged"}
    assert all((copied / step.place).exists() for step in found.made_from)
    down = lineage_of(paths, "fmus/office/Office.fmu").made_of_it
    names = {step.name for step in down}
    assert {f"{LABEL}/calibrate-n0016", f"{LABEL}/calibrate-adaptive", f"{LABEL}/sensitivity"} <= names
    weights = copied / "mlruns" / "champions" / LABEL / "n0016" / "weights.npz"
    weights.write_bytes(weights.read_bytes()[:-1])
    (copied / "data" / "office" / "occupancy_600s.csv").unlink()
    states = {step.kind: step.state for step in lineage_of(paths, found.thing.name).made_from}
    assert (states["model"], states["recording"], states["FMU"]) == ("changed", "missing", "unchanged")


@pytest.mark.parametrize(
    ("recorded", "now", "is_equal", "relative"),
    [
        (1.0, 1.0, True, 0.0),
        (1.0, np.nextafter(1.0, 2.0), False, 2.220446049250313e-16),
        (float("nan"), float("nan"), True, 0.0),
        (1.0, None, False, None),
        ("pruned", "pruned", True, None),
        ([1.0, 2.0], [1.0, 2.0], True, 0.0),
        ([1.0, 2.0], [1.0, 2.5], False, 0.25),
        ([1.0, 2.0], [1.0], False, None),
        ([1.0, float("nan")], [1.0, float("nan")], True, 0.0),
    ],
)
def test_numbers_are_compared_to_the_last_digit(
    recorded: Any, now: Any, is_equal: bool, relative: float | None
) -> None:
    (row,) = compare({"x": recorded}, {"x": now})
    assert (row.is_equal, row.relative) == (is_equal, relative)


def test_of_a_curve_those_points_are_compared_that_were_recorded() -> None:
    now = {"epoch": np.array([1.0, 2.0, 3.0, 4.0]), "loss": np.array([4.0, 3.0, 2.0, 1.0])}
    assert aligned(now, {"epoch": np.array([1.0, 4.0])})["loss"].tolist() == [4.0, 1.0]
    assert aligned(now, {"epoch": np.array([1.0, 5.0])}) is now
