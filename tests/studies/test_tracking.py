"""MLflow's view of studies: searchable, nested, complete however often it is written."""

import errno
import json
import logging
import math
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tuning_checks import ignore

from studies.paths import ProjectPaths
from studies.report.wording import significant
from studies.search_ranges import SearchRanges
from studies.tracking.mlflow_runs import RunStore
from studies.tracking.mlflow_tracker import MlflowTracker
from studies.tracking.tracker import NullTracker, PatientTracker, StageRun, Tracker
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord, best_record, read_history, read_records, summarize
from studies.tuning.trial_worker import run_study

MakeSpec = Callable[..., StudySpec]
N = 7


@pytest.fixture(scope="module")
def study(make_spec: MakeSpec, tmp_path_factory: pytest.TempPathFactory) -> tuple[StudySpec, Path]:
    """A finished study with completed, pruned and failed trials, and the folder of its records."""
    paths = ProjectPaths(tmp_path_factory.mktemp("tracked"))
    mlruns = paths.mlruns
    spec = make_spec()
    run_study(spec, paths=paths, n_trials=N, emit=ignore)
    return spec, spec.folder(mlruns)


def tell_all(tracker: Tracker, spec: StudySpec, folder: Path, n_trials: int = N) -> None:
    """Tell a tracker a study's whole story."""
    tracker.start_study(spec, n_trials=n_trials)
    records = read_records(folder)[:n_trials]
    for record in records:
        tracker.log_trial(spec, record, lambda record=record: read_history(folder, record.index))
    tracker.finish_study(spec, summarize(spec, records, None), "FINISHED")


def runs(tracker: MlflowTracker, wanted: str = "") -> list[Any]:
    client = tracker.client
    experiment = client.get_experiment_by_name("toy-small")
    assert experiment is not None
    return list(client.search_runs([experiment.experiment_id], wanted))


def test_trials_are_runs_below_their_study(tracker: MlflowTracker, study: tuple[StudySpec, Path]) -> None:
    spec, folder = study
    tell_all(tracker, spec, folder)
    (parent,) = runs(tracker, "tags.role = 'study'")
    trials = runs(tracker, f"tags.`mlflow.parentRunId` = '{parent.info.run_id}'")
    assert len(trials) == N
    assert parent.info.run_name == "n0016 study"
    assert parent.info.status == "FINISHED"
    assert {run.info.run_name for run in trials} == {f"n0016 trial {index:03d}" for index in range(N)}
    by_key = {run.data.tags["trial_key"]: run for run in trials}
    for record in read_records(folder):
        run = by_key[record.key]
        assert (
            run.info.status == {"complete": "FINISHED", "pruned": "KILLED", "failed": "FAILED"}[record.state]
        )
        assert run.info.start_time == round(1000 * record.started_s)
        assert run.info.end_time == round(1000 * record.ended_s)
        assert {k: v for k, v in run.data.metrics.items() if k in record.metrics} == record.metrics
        assert run.data.params["n_latent"] == str(record.config["n_latent"])
        assert run.data.params["seed"] == str(record.seed)
        expected = {
            "case": "toy",
            "label": "toy-small",
            "n_train": "16",
            "variant": "refined",
            "state": record.state,
        }
        assert expected.items() <= run.data.tags.items()
        assert run.data.tags["train_sha256"] == spec.train_digest
        assert run.data.tags["fmu_sha256"] == "f" * 64
    datasets = {one.dataset.name: one.dataset for one in parent.inputs.dataset_inputs}
    assert set(datasets) == {"toy train n=16", "toy validation", "toy test"}
    assert json.loads(datasets["toy train n=16"].profile)["num_rows"] == 16


def test_runs_are_found_by_their_errors(tracker: MlflowTracker, study: tuple[StudySpec, Path]) -> None:
    spec, folder = study
    tell_all(tracker, spec, folder)
    records = [r for r in read_records(folder) if r.state == "complete"]
    limit = min(r.metrics["test/p90"] for r in records)
    (found,) = runs(
        tracker, f"metrics.`test/p90` <= {limit!r} and metrics.`val/mae` > 0 and tags.role = 'trial'"
    )
    assert found.data.metrics["test/p90"] == limit
    best = best_record(records)
    assert best is not None
    shown = float(f"{best.metrics['val/mae']:.4g}")
    (parent,) = runs(tracker, f"metrics.`best/val/mae` = {shown!r}")
    assert parent.data.metrics["best/test/p90"] == pytest.approx(best.metrics["test/p90"], rel=5e-4)
    assert parent.data.tags["best_trial"] == str(best.index)


def test_learning_curves_are_thinned_but_keep_their_ends(
    tracker: MlflowTracker, study: tuple[StudySpec, Path]
) -> None:
    spec, folder = study
    tell_all(tracker, spec, folder)
    record = read_records(folder)[0]
    run_id = tracker.trial_run_id(spec, record.key)
    curve = tracker.client.get_metric_history(run_id, "curve/validation_mae")
    history = read_history(folder, 0)
    assert len(curve) <= 60
    assert curve[0].step == history["epoch"][0]
    assert curve[-1].step == history["epoch"][-1]
    assert curve[-1].value == history["validation_mae"][-1]


def test_telling_twice_changes_nothing(
    tracker: MlflowTracker, study: tuple[StudySpec, Path], project: ProjectPaths
) -> None:
    spec, folder = study
    tell_all(tracker, spec, folder)
    before = {run.info.run_id: (run.info.status, run.info.end_time, run.data) for run in runs(tracker)}
    tell_all(tracker, spec, folder)
    tell_all(MlflowTracker(project), spec, folder)
    after = {run.info.run_id: (run.info.status, run.info.end_time, run.data) for run in runs(tracker)}
    assert before.keys() == after.keys()
    for run_id, (status, end, data) in before.items():
        assert after[run_id][:2] == (status, end)
        assert after[run_id][2].to_dictionary() == data.to_dictionary()


def test_extended_study_goes_on_in_the_same_run(
    tracker: MlflowTracker, study: tuple[StudySpec, Path]
) -> None:
    spec, folder = study
    tell_all(tracker, spec, folder, n_trials=2)
    tell_all(tracker, spec, folder)
    (parent,) = runs(tracker, "tags.role = 'study'")
    assert parent.info.status == "FINISHED"
    assert parent.data.tags["n_trials"] == str(N)
    assert len(runs(tracker, "tags.role = 'trial'")) == N


def test_run_that_was_interrupted_half_way_is_completed(
    tracker: MlflowTracker,
    study: tuple[StudySpec, Path],
    project: ProjectPaths,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    spec, folder = study
    with monkeypatch.context() as patch:
        patch.setattr(tracker.client, "set_terminated", _die)
        with pytest.raises(KeyboardInterrupt):
            tell_all(tracker, spec, folder)
    assert [run.info.status for run in runs(tracker, "tags.role = 'trial'")] == ["RUNNING"]
    tell_all(MlflowTracker(project), spec, folder)
    trials = runs(tracker, "tags.role = 'trial'")
    assert len(trials) == N
    assert {run.info.status for run in trials} <= {"FINISHED", "KILLED", "FAILED"}
    record = read_records(folder)[0]
    curve = tracker.client.get_metric_history(tracker.trial_run_id(spec, record.key), "curve/validation_mae")
    assert len({point.step for point in curve}) == len(curve)


def _die(*arguments: object) -> None:
    raise KeyboardInterrupt


def test_failed_trial_shows_its_reason(tracker: MlflowTracker, study: tuple[StudySpec, Path]) -> None:
    spec, folder = study
    good = read_records(folder)[0]
    bad = TrialRecord(
        study=spec.name,
        n_train=16,
        index=99,
        state="failed",
        reason="MemoryError: too wide",
        params=good.params,
        config=good.config,
        seed=1,
        started_s=good.started_s,
        wall_s=1.0,
        digests=good.digests,
        owner=good.owner,
    )
    tracker.start_study(spec, n_trials=N)
    tracker.log_trial(spec, bad, dict)
    (run,) = runs(tracker, "tags.state = 'failed'")
    assert run.info.status == "FAILED"
    assert run.data.tags["reason"] == "MemoryError: too wide"


def test_stage_is_a_run_with_curve_and_figures(tracker: MlflowTracker, tmp_path: Path) -> None:
    figure = tmp_path / "polish.png"
    figure.write_bytes(b"png")
    stage = StageRun(
        label="toy-small",
        kind="calibration",
        name="n0016 calibration",
        key="k1",
        params={"ftol": 1e-4},
        metrics={"calibration/mse_polished": 0.01},
        curves={"calibration/best_mse": [(17, 0.5), (40, 0.01)]},
        tags={"case": "toy", "n_train": 16},
        figures=[figure],
        started_s=1e9,
        wall_s=2.0,
        note="A toy.",
    )
    tracker.log_stage(stage)
    tracker.log_stage(stage)
    (run,) = runs(tracker, "tags.role = 'calibration' and metrics.`calibration/mse_polished` < 0.02")
    assert run.info.status == "FINISHED"
    assert run.info.end_time - run.info.start_time == 2000
    assert [p.step for p in tracker.client.get_metric_history(run.info.run_id, "calibration/best_mse")] == [
        17,
        40,
    ]
    assert [file.path for file in tracker.client.list_artifacts(run.info.run_id, "figures")] == [
        "figures/polish.png"
    ]
    assert math.isclose(run.data.metrics["calibration/best_mse"], 0.01)


def test_a_stage_that_came_to_other_numbers_is_another_run(tracker: MlflowTracker) -> None:
    # Modelica's arrays have signs in their names that MLflow refuses.
    named = {"wall[1].R (Ω)": 0.1, "b": math.inf}
    first = StageRun("toy-small", "sensitivity", "sensitivity", "k1", metrics=named)
    second = replace(first, metrics={**named, "wall[1].R (Ω)": 0.2})
    for stage in (first, second, second, first):
        tracker.log_stage(stage)
    told = [run.data.metrics["wall_1_.R _Ω_"] for run in runs(tracker, "tags.role = 'sensitivity'")]
    assert sorted(told) == [0.1, 0.2]


def test_a_study_is_credited_with_its_own_surrogates_calibration_alone(
    tracker: MlflowTracker, study: tuple[StudySpec, Path]
) -> None:
    spec, folder = study
    tell_all(tracker, spec, folder)

    (parent,) = runs(tracker, "tags.role = 'study'")
    best = int(parent.data.tags["best_trial"])

    def calibrate(name: str, mse: float, **tags: Any) -> None:
        numbers = {"mse/polished": mse, "calls/all": 100}
        tags = {"n_train": 16, "surrogate_study": spec.name, "surrogate_trial": best, **tags}
        tracker.log_stage(StageRun("toy-small", "calibration", name, name, metrics=numbers, tags=tags))

    calibrate("ours", 0.25)
    calibrate("of few parameters", 0.5, n_free=3)
    calibrate("with an earlier best trial", 0.6, surrogate_trial=best + 1)
    calibrate("with another surrogate", 0.75, surrogate_study="toy-small/n0016/00000000")
    history = tracker.client.get_metric_history(parent.info.run_id, "calibrated/mse")
    assert {point.value for point in history} == {0.25}
    # Trained on, the study has another best trial, with which nothing is calibrated yet.
    tracker.client.set_tag(parent.info.run_id, "best_trial", str(best + 2))
    calibrate("with the former best trial", 0.2)
    (parent,) = runs(tracker, "tags.role = 'study'")
    assert math.isnan(parent.data.metrics["calibrated/mse"])


def test_a_study_tells_the_settings_that_it_tuned(
    tracker: MlflowTracker, study: tuple[StudySpec, Path]
) -> None:
    spec, folder = study
    tell_all(tracker, replace(spec, search=SearchRanges(n_layers=(2, 3))), folder)
    (parent,) = runs(tracker, "tags.role = 'study'")
    told = {name for name in parent.data.tags if name.startswith("best_")}
    assert told == {"best_trial", "best_n_layers"}


def test_store_broken_in_the_middle_does_not_stop_a_study(
    make_spec: MakeSpec, caplog: pytest.LogCaptureFixture
) -> None:
    class Broken(NullTracker):
        def log_trial(self, *arguments: object, **named: object) -> None:
            raise OSError("database is locked")

    tracker = PatientTracker(Broken())
    record: Any = object()
    with caplog.at_level(logging.WARNING):
        tracker.log_trial(make_spec(), record, dict)
    assert "database is locked" in caplog.text


def test_store_that_comes_back_is_waited_for(make_spec: MakeSpec, caplog: pytest.LogCaptureFixture) -> None:
    class Restarting(NullTracker):
        n_calls = 0

        def log_trial(self, *arguments: object, **named: object) -> None:
            self.n_calls += 1
            if self.n_calls < 3:
                raise OSError(errno.ENOSPC, "No space left on device")

    restarting = Restarting()
    record: Any = object()
    with caplog.at_level(logging.WARNING):
        PatientTracker(restarting).log_trial(make_spec(), record, dict)
    assert restarting.n_calls == 3
    assert [line for line in caplog.messages if "waiting for it" in line]
    assert "missed something" not in caplog.text


def test_two_machines_make_one_run_per_trial(
    tracker: MlflowTracker, study: tuple[StudySpec, Path], project: ProjectPaths
) -> None:
    spec, folder = study
    other = MlflowTracker(project)
    for one in (tracker, other):
        one.start_study(spec, n_trials=N)
    for record in read_records(folder):
        for one in (tracker, other):
            one.log_trial(spec, record, dict)
    assert len(runs(tracker, "tags.role = 'trial'")) == N
    assert len(runs(tracker, "tags.role = 'study'")) == 1


def test_runs_of_a_dead_process_are_ended_and_completed_by_the_next(
    tracker: MlflowTracker, study: tuple[StudySpec, Path], project: ProjectPaths
) -> None:
    spec, folder = study
    tracker.start_study(spec, n_trials=N)
    (run,) = runs(tracker, "tags.role = 'study'")
    assert tracker.end_ghosts() == [], "its process lives"
    owner = json.loads(run.data.tags["owner"])
    tracker.client.set_tag(run.info.run_id, "owner", json.dumps({**owner, "process_started_s": 1.0}))
    assert tracker.end_ghosts() == ["n0016 study"]
    assert not runs(tracker, "attributes.status = 'RUNNING'")
    tell_all(MlflowTracker(project), spec, folder)
    (run,) = runs(tracker, "tags.role = 'study'")
    assert run.info.status == "FINISHED"
    assert "interrupted" not in run.data.tags


def test_overview_says_which_model_is_best_and_shows_all_trials(
    tracker: MlflowTracker, study: tuple[StudySpec, Path]
) -> None:
    spec, folder = study
    tell_all(tracker, spec, folder)
    (overview,) = runs(tracker, "tags.role = 'overview'")
    best = best_record(read_records(folder))
    assert best is not None
    assert f"n = 16: **{significant(best.metrics['test/mae'])}**" in overview.data.tags["mlflow.note.content"]
    assert [file.path for file in tracker.client.list_artifacts(overview.info.run_id)] == ["mae_over_n.png"]
    experiment = tracker.client.get_experiment(overview.info.experiment_id)
    assert "mae_over_n.png" in experiment.tags["mlflow.note.content"]
    view = json.loads(experiment.tags["mlflow.sharedViewState.leaderboard"])
    assert "metrics.`best/test/mae`" in json.loads(view["state"])["selectedColumns"]
    (parent,) = runs(tracker, "tags.role = 'study'")
    drawn = {file.path for file in tracker.client.list_artifacts(parent.info.run_id, "figures")}
    assert {"figures/learning_curves.png", "figures/slices.png"} <= drawn


def test_two_processes_have_made_the_database_and_two_can_make_an_experiment(
    tracker: MlflowTracker, project: ProjectPaths
) -> None:
    other = MlflowTracker(project)
    both = threading.Barrier(2)

    def make(one: MlflowTracker) -> str:
        both.wait()
        return one.runs.experiment("both")

    with ThreadPoolExecutor(2) as pool:
        first, second = pool.map(make, (tracker, other))
    assert first == second


def test_a_machine_that_does_not_reach_the_files_says_so_once_and_goes_on(
    tracker: MlflowTracker, study: tuple[StudySpec, Path], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    spec, folder = study
    elsewhere = tmp_path / "another-machine" / "artifacts"
    tracker.client.create_experiment(spec.label, elsewhere.as_uri())
    with caplog.at_level(logging.WARNING):
        tell_all(tracker, spec, folder)
    (line,) = [line for line in caplog.messages if "out of this machine's reach" in line]
    assert str(elsewhere) in line
    assert not elsewhere.exists()
    assert len(runs(tracker, "tags.role = 'trial'")) == N


def test_a_database_whose_making_was_killed_is_made_again(tmp_path: Path) -> None:
    paths = ProjectPaths(tmp_path)
    code = (
        "import sys; from pathlib import Path; from studies.paths import ProjectPaths; "
        "from studies.tracking.mlflow_runs import RunStore; RunStore(ProjectPaths(Path(sys.argv[1])))"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)]) as making:
        deadline = time.monotonic() + 60.0
        while not any(file.stat().st_size for file in paths.mlruns.glob(".mlflow.db-making")):
            assert making.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        making.kill()
    assert not paths.tracking_database.exists()
    assert RunStore(paths).experiment("toy-small")
    assert [file.name for file in paths.mlruns.glob("*mlflow.db*")] == ["mlflow.db"]
