"""A run that is interrupted, by Ctrl-C or by SIGKILL, ends where an uninterrupted one does."""

import json
import re
import shutil
import signal
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from project_for_tests import (
    SMOKE_RUN,
    Run,
    copy_of,
    finish,
    interrupt,
    make_hostile,
    stored_simulations,
)

from studies.cli import main
from studies.paths import ProjectPaths
from studies.tracking.quiet_mlflow import connect
from studies.tracking.runs import RunStore
from studies.tuning.storage import open_storage
from studies.tuning.study_results import read_studies

LABEL = "office-smoke"


def a_trial_has_ended(project: Path, text: str) -> bool:
    """Notice the first trial of the smaller size, read as any program may: without a lock."""
    file = project / "mlruns" / "optuna.db"
    try:
        with closing(sqlite3.connect(f"file:{file}?mode=ro", uri=True)) as database:
            (n,) = database.execute(
                "select count(*) from trials join studies using (study_id) "
                "where state = 'COMPLETE' and study_name like '%n0016%'"
            ).fetchone()
    except sqlite3.Error:
        return False
    return bool(n)


def calibrates(project: Path, text: str) -> bool:
    return "calibrate-n0016: differential" in text


def results(project: Path) -> dict[str, Any]:
    """Return all numbers that a run leaves, without times, processes and places."""
    folder = project / "mlruns" / "results" / LABEL
    found: dict[str, Any] = {file.name: calibration(file) for file in folder.glob("calibrate-*.json")}
    for name in ("simulate", "sensitivity"):
        summary = json.loads((folder / f"{name}.json").read_text())["result"]
        found[name] = {key: value for key, value in summary.items() if key != "n_reused"}
    for study in read_studies(ProjectPaths(project)):
        kept = ("state", "params", "value", "metrics", "proposed_by", "n_epochs", "best_epoch",
                "weights_sha256")  # fmt: skip
        for place, trial in enumerate(study.trials):
            found[f"{study.spec.name}/{place}"] = {key: getattr(trial, key) for key in kept}
    return found


def calibration(file: Path) -> dict[str, Any]:
    """Return the result of a calibration, without what names the run of its surrogate and its own work."""
    numbers: dict[str, Any] = json.loads(file.read_text())["result"]
    # A trial that was killed and run again has another number, which names a mean too, and another run.
    del numbers["screening"]["run_id"], numbers["screening"]["trial"]
    numbers["screening"]["model"] = re.sub(r"trial \d+", "trial", numbers["screening"]["model"])
    # Rows that a killed command has stored are neither simulated nor repeated again.
    del numbers["n_simulated"], numbers["n_repeated"]
    return numbers


def open_runs(project: Path) -> list[str]:
    """Return the runs that MLflow takes for running ones."""
    client = connect(ProjectPaths(project).tracking_uri)
    ids = [one.experiment_id for one in client.search_experiments()]
    return [run.info.run_name for run in client.search_runs(ids, "attributes.status = 'RUNNING'")]


def stored_rows(project: Path) -> dict[str, int]:
    """Return the number of each stored simulation; one that is done again has a later one."""
    return {
        f"{name}: {theta.hex()}": number
        for name, rows in stored_simulations(project).items()
        for theta, number in zip(rows["_theta"], rows["_id"], strict=True)
    }


def finished_work(project: Path) -> dict[str, object]:
    """Return the identity of every finished simulation and trial; redone ones are others."""
    return ended_trials(project) | stored_rows(project)


def ended_trials(project: Path) -> dict[str, object]:
    """Return when each trial ended, by study and number; those of a killed worker have not ended."""
    file = project / "mlruns" / "optuna.db"
    if not file.is_file():
        return {}
    with closing(sqlite3.connect(file)) as database:
        try:
            rows = database.execute(
                "select study_id, number, datetime_complete from trials where state in ('COMPLETE', 'PRUNED')"
            ).fetchall()
        except sqlite3.Error:  # its tables are not made yet
            return {}
    return {f"{study_id}/{number}": ended for study_id, number, ended in rows}


def assert_stopped(project: Path) -> None:
    """Check that the smaller size was not tuned to the end, and that Optuna and MLflow know it."""
    found = [one for one in read_studies(ProjectPaths(project)) if one.spec.n_train == 16]
    assert sum(one.n_ended for one in found) >= 1
    assert [one.count("running") for one in found] == [0, 0]
    assert open_runs(project) == []
    unfinished = [one.spec for one in found if one.n_ended < one.n_planned]
    assert unfinished
    for spec in unfinished:
        tags = {"role": "baseline study" if spec.is_baseline else "study", "study": spec.name}
        # The first one is of the run that this project was copied from.
        *_, run = RunStore(ProjectPaths(project)).find(LABEL, tags)
        assert run.info.status == "KILLED"


def test_a_second_run_finds_everything_finished(
    whole_run: Path, tmp_path: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = copy_of(whole_run, tmp_path / "project", monkeypatch)
    work = finished_work(project)
    log = studies(*SMOKE_RUN[3:]).err
    stages = ("check", "simulate", "sensitivity", "tune", "calibrate-n0016", "calibrate-n0032", "report")
    for stage in stages:
        assert f"{stage}: finished before" in log
    assert finished_work(project) == work
    assert open_runs(project) == []


def test_the_best_surrogate_gives_the_indices_and_the_fmu_where_it_is_asked(
    whole_run: Path, tmp_path: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = copy_of(whole_run, tmp_path / "project", monkeypatch)
    command = ("sensitivity", "--profile", "smoke", "--json", "-q")
    before = sum(map(len, stored_simulations(project, "office").values()))
    values = {
        one.spec.n_train: one.best.value or 1.0 for one in read_studies(ProjectPaths(project)) if one.best
    }
    asked = studies(*command).stage
    assert asked["n_train"] == min(values, key=values.__getitem__)
    assert sum(map(len, stored_simulations(project, "office").values())) == before
    simulated = studies(*command, "--fmu").stage
    assert (simulated.get("n_train"), simulated["n_calls"]) == (None, 8 * 16)
    assert sum(map(len, stored_simulations(project, "office").values())) > before


@pytest.mark.slow
def test_an_interrupted_run_ends_the_same(
    tmp_path: Path, whole_run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    project = copy_of(whole_run, tmp_path / "project", monkeypatch)
    # All that a run is interrupted in is undone; the simulations before are its own, and its smaller size.
    storage = open_storage(ProjectPaths(project))
    for study in storage.get_all_studies():
        if "n0016" in study.study_name:
            storage.delete_study(study._study_id)
    storage.engine.dispose()
    for file in (project / "mlruns" / "results" / LABEL).glob("calibrate-n0016*"):
        file.unlink()
    # No process imports what lies in the working folder, as workers of Python's own would.
    folder = make_hostile(tmp_path / "hostile")
    # While workers tune, Ctrl-C is the harder test, and in a calibration a kill is.
    for how, is_moment in ((signal.SIGINT, a_trial_has_ended), (signal.SIGKILL, calibrates)):
        before = finished_work(project)
        code, log = interrupt((*SMOKE_RUN[:-1], "1"), project, how, is_moment, folder=folder)
        assert not (folder / "caught").exists()
        if how is signal.SIGINT:
            # Both are 130 to a shell: CPython ends as killed by SIGINT where Ctrl-C came inside an exec().
            assert code in (130, -signal.SIGINT), log
            assert log.splitlines()[-1].startswith("studies: interrupted"), log
            assert "studies run --profile smoke --jobs 1" in log.splitlines()[-1]
            assert "Traceback" not in log
            assert_stopped(project)
            # The calibrations are all that is left for the other one.
            assert main(("tune", *SMOKE_RUN[4:], "-q")) == 0
        else:
            assert code == -signal.SIGKILL
        after = finished_work(project)
        assert {name: after.get(name) for name in before} == before, f"work was redone or lost at {how.name}"
    before = finished_work(project)
    finish(project)
    after = finished_work(project)
    assert {name: after.get(name) for name in before} == before
    assert "simulate: finished before" in capsys.readouterr().err
    undisturbed = results(shutil.copytree(whole_run, tmp_path / "undisturbed"))
    assert {"calibrate-n0016.json", "calibrate-n0032.json"} <= set(undisturbed)
    assert results(project) == undisturbed
    assert open_runs(project) == []


def test_a_limit_in_time_before_the_first_trial_is_said(project: Path, studies: Run) -> None:
    words = ("tune", "--profile", "smoke", "--n-train", "16")
    assert studies("simulate", *words[1:3]).code == 0
    first = studies(*words, "--max-hours", "1e-9", "--parallel", "2")
    assert first.code == 1
    assert first.err.splitlines()[-1].endswith(
        "--max-hours ended it after 0 of 2 trials; the same command goes on; "
        "n_train = 16 has no complete trial yet"
    )
    # The study is there, and the same command finds it.
    (known,) = (one for one in studies("status", "--json").document["studies"] if not one["is_baseline"])
    assert (known["n_train"], known["n_planned"], known["n_complete"]) == (16, 2, 0)


def test_a_calibration_that_a_limit_in_time_ended_goes_on(
    project: Path, tmp_path: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("calibrate", "wall", "--max-calls", "12", "--no-state-equations", "--json")
    late = studies(*words[:-1], "--max-hours", "1e-9")
    assert (late.code, late.out) == (1, "")
    assert late.err.splitlines()[-1].endswith(
        "ended it; the finished simulations are kept, and the same command goes on; no call so far"
    )
    # Time for some of the simulations, whose processes take a tenth of a second each.
    studies(*words, "--max-hours", str(0.7 / 3600.0))
    assert studies(*words).stage["ledger"]["n_adaptive"] == 12
