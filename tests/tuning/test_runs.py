"""Trials as MLflow shows them, to its own clients: runs, the best per size, models, a moved project."""

import json
import os
import shutil
import sys
import time
import warnings
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import pandas as pd
import pytest
from forked_for_tests import FORKED, make_stores
from mlflow.exceptions import MlflowException
from toy_study_for_tests import (
    LABEL,
    N_TUNED,
    SPECS,
    plain_study,
    runs_of,
    toy_study,
    tuned_study,
)

from studies.paths import ProjectPaths
from studies.tracking.artifacts import ProjectArtifacts
from studies.tracking.quiet_mlflow import connect
from studies.tracking.runs import RunStore, load_surrogate, register_best
from studies.tuning.storage import open_storage
from studies.tuning.study_results import read_studies
from studies.tuning.tune_studies import tune
from studies.tuning.worker import Worker

pytestmark = pytest.mark.filterwarnings("ignore")  # MLflow's of its own dependencies, used plainly here
THETA = pd.DataFrame({"R": [1.0, 2.0, 3.0], "C": [1e4, 2e4, 3e4]})


def best_per_size(paths: ProjectPaths) -> pd.DataFrame:
    mlflow.set_tracking_uri(paths.tracking_uri)
    found = mlflow.search_runs(experiment_names=[LABEL], filter_string="tags.best = 'yes'")
    assert isinstance(found, pd.DataFrame)
    return found


def test_a_complete_trial_has_its_run(tuned: ProjectPaths) -> None:
    spec = tuned_study(16)
    study = plain_study(tuned, spec.name)
    best, client = study.best_trial, connect(tuned.tracking_uri)
    run = client.get_run(best.user_attrs["mlflow_run_id"])
    parent = client.get_run(run.data.tags["mlflow.parentRunId"])
    assert parent.data.tags["role"] == "study"
    assert parent.data.tags["study"] == run.data.tags["study"] == spec.name
    assert run.data.tags["trial"] == str(best.number)
    assert {name: run.data.params[name] for name in best.params} == {
        n: str(v) for n, v in best.params.items()
    }
    assert set(best.params) == {"n_latent", "n_hidden", "beta"}
    assert run.data.params["learning_rate"] == str(spec.base_config.learning_rate)
    errors = {name: value for name, value in run.data.metrics.items() if name.startswith(("val/", "test/"))}
    assert set(errors) == {f"{of}/{name}" for of in ("val", "test") for name in ("mae", "p90", "unexplained")}
    assert errors["val/mae"] == best.value
    curve = client.get_metric_history(run.info.run_id, "curve/validation_mae")
    assert [point.step for point in curve] == list(range(1, 13))
    assert min(point.value for point in curve) == pytest.approx(errors["val/mae"])
    assert {one.path for one in client.list_artifacts(run.info.run_id)} >= {"provenance.json", "surrogate"}


def test_a_pruned_trial_has_the_errors_of_its_best_epoch_and_wins_no_search(tuned: ProjectPaths) -> None:
    pruned = runs_of(tuned, LABEL, pruned="True")
    assert pruned
    for run in pruned:
        assert run.info.status == "FINISHED"
        assert run.data.tags["reason"].startswith("pruned by MedianPruner at epoch ")
        errors = {name for name in run.data.metrics if name.startswith(("val/", "test/"))}
        # The error that chooses is a complete trial's alone.
        assert errors == {"val/p90", "val/unexplained", "test/mae", "test/p90", "test/unexplained"}
        assert "curve/validation_mae" in run.data.metrics


def test_the_least_error_of_each_size_is_found_in_one_call_and_is_the_champion_s(tuned: ProjectPaths) -> None:
    mlflow.set_tracking_uri(tuned.tracking_uri)
    found = mlflow.search_runs(experiment_names=[LABEL], filter_string="metrics.`val/mae` > 0")
    assert isinstance(found, pd.DataFrame)
    found = found[found["tags.role"].isin(["trial", "mean"])]
    least = found.loc[found.groupby("params.n_train")["metrics.val/mae"].idxmin()]
    for _, row in least.iterrows():
        name = f"{LABEL}-n{int(row['params.n_train']):04d}"
        version = connect(tuned.tracking_uri).get_model_version_by_alias(name, "champion")
        assert row["run_id"] == version.run_id
        assert version.description is not None
        if row["tags.role"] == "mean":
            assert version.description.startswith(f"{row['params.model']} of ")
        else:
            assert version.tags["n_latent"] == row["params.n_latent"]
            assert f"n_latent {row['params.n_latent']}" in version.description
        assert "metrics.gain" in row


def test_loss_and_its_terms_are_written_at_every_validated_epoch(tuned: ProjectPaths) -> None:
    client = connect(tuned.tracking_uri)
    for run in runs_of(tuned, LABEL, role="trial"):
        terms = [name for name in run.data.metrics if name.startswith("curve/")]
        assert {"curve/loss", "curve/kl"} <= set(terms)
        n_points = {len(client.get_metric_history(run.info.run_id, name)) for name in terms}
        assert len(n_points) == 1, n_points


def test_rarely_validated_epochs_leave_all_their_terms(project: ProjectPaths) -> None:
    rare = toy_study(16).settings | {"max_epochs": 130, "patience": 130, "validate_every": 5}
    spec = toy_study(16, settings=rare)
    tune([spec], paths=project, n_trials=1, n_jobs=1, until_s=0.0)
    Worker(project, spec.name).run()
    (run,) = runs_of(project, LABEL, role="trial")
    points = connect(project.tracking_uri).get_metric_history(run.info.run_id, "curve/kl")
    assert [point.step for point in points] == list(range(5, 131, 5))


def test_the_run_of_a_study_says_what_it_came_to(tuned: ProjectPaths) -> None:
    spec = tuned_study(24)
    (run,) = runs_of(tuned, LABEL, role="study", study=spec.name)
    assert run.info.status == "FINISHED"
    assert run.data.metrics["best/val/mae"] == plain_study(tuned, spec.name).best_value
    assert {"best/n_latent", "best/n_hidden", "best/beta", "best/test/p90"} <= set(run.data.metrics)
    assert run.data.metrics["n_complete"] + run.data.metrics["n_pruned"] == N_TUNED
    note = run.data.tags["mlflow.note.content"]
    assert note.startswith(f"Best trial {run.data.tags['best_trial']}: test MAE ")
    assert note.endswith("\n\nA toy.")
    client = connect(tuned.tracking_uri)
    (picture,) = client.list_artifacts(run.info.run_id, "figures")
    assert picture.path == "figures/trials.svg"


def test_what_a_person_writes_into_a_note_stays(copied: ProjectPaths) -> None:
    client, spec = connect(copied.tracking_uri), tuned_study(16)
    experiment = client.get_experiment_by_name(LABEL)
    assert experiment is not None
    name, note = "mlflow.note.content", experiment.tags["mlflow.note.content"]
    assert note.startswith("Best per n_train (")
    client.set_experiment_tag(experiment.experiment_id, name, f"{note}\n\nAsk Ada about n = 24.")
    tune([spec], paths=copied, n_trials=N_TUNED, n_jobs=1)
    assert client.get_experiment(experiment.experiment_id).tags[name] == f"{note}\n\nAsk Ada about n = 24."
    client.set_experiment_tag(experiment.experiment_id, name, "Mine alone.")
    tune([spec], paths=copied, n_trials=N_TUNED, n_jobs=1)
    ours, mine = client.get_experiment(experiment.experiment_id).tags[name].split("\n\n")
    assert (ours, mine) == (note.split("\n\n")[0], "Mine alone.")


def test_the_views_of_an_experiment_show_what_its_studies_search(tuned: ProjectPaths) -> None:
    experiment = connect(tuned.tracking_uri).get_experiment_by_name(LABEL)
    assert experiment is not None
    table, charts = (
        json.loads(experiment.tags[f"mlflow.sharedViewState.{name}"]) for name in ("leaderboard", "charts")
    )
    assert {"metrics.`test/mae`", "params.`beta`", "metrics.`gain`"} <= set(table["selectedColumns"])
    assert table["searchFilter"] == "tags.best = 'yes'"
    assert (table["orderByKey"], table["orderByAsc"]) == ("metrics.`test/mae`", True)
    scatters = [one["xaxis"]["key"] for one in charts["compareRunCharts"] if one["type"] == "SCATTER"]
    assert scatters == ["n_train", "n_train", "n_latent", "n_hidden", "beta"]


def test_the_best_of_each_size_is_found_in_one_call_also_after_more_trials(copied: ProjectPaths) -> None:
    before = best_per_size(copied)
    assert sorted(before["params.n_train"]) == ["16", "24"]
    assert before["metrics.test/p90"].notna().all()
    spec = tuned_study(16)
    tune([spec], paths=copied, n_trials=N_TUNED + 2, n_jobs=1, until_s=0.0)
    study = plain_study(copied, spec.name)
    default = study.trials[0].params
    study.enqueue_trial(default | {"n_latent": 7})
    study.enqueue_trial(default | {"n_latent": 6})
    Worker(copied, spec.name).run()
    tune([spec], paths=copied, n_trials=N_TUNED + 2, n_jobs=1)
    after = best_per_size(copied)
    assert sorted(after["params.n_train"]) == ["16", "24"]
    best = {one.spec.n_train: one.best for one in read_studies(copied) if not one.spec.is_baseline}
    for _, row in after.iterrows():
        found = best[int(row["params.n_train"])]
        assert found is not None
        assert row["run_id"] == found.run_id
        version = connect(copied.tracking_uri).get_model_version_by_alias(
            f"{LABEL}-n{int(row['params.n_train']):04d}", "champion"
        )
        assert version.run_id == found.run_id


def test_a_registration_leaves_the_process_as_it_was(copied: ProjectPaths, tmp_path: Path) -> None:
    baseline = next(one for one in read_studies(copied) if one.spec.is_baseline)
    assert baseline.best is not None
    mlflow.set_tracking_uri(f"sqlite:///{tmp_path}/own.db")
    before = mlflow.get_tracking_uri(), sys.path.copy(), dict(os.environ), warnings.filters.copy()
    register_best(RunStore(copied), baseline.best)  # which tuning does for networks alone
    assert (mlflow.get_tracking_uri(), sys.path, dict(os.environ), warnings.filters) == before
    assert not (tmp_path / "own.db").exists()  # nothing was asked of it either


@pytest.mark.parametrize("n_train", [16, 24])
def test_the_best_model_of_a_size_is_loaded_by_mlflow_alone(tuned: ProjectPaths, n_train: int) -> None:
    mlflow.set_tracking_uri(tuned.tracking_uri)
    predicted = mlflow.pyfunc.load_model(tuned_study(n_train).model_uri).predict(THETA)
    assert predicted.shape == (3, 25, 1)
    best = next(one.best for one in read_studies(tuned) if one.spec == tuned_study(n_train))
    assert best is not None
    same = load_surrogate(RunStore(tuned), best.run_id).predict(THETA.to_numpy())
    np.testing.assert_array_equal(predicted, same)


def test_the_registered_model_takes_whole_numbers_any_order_and_a_dict(tuned: ProjectPaths) -> None:
    mlflow.set_tracking_uri(tuned.tracking_uri)
    model = mlflow.pyfunc.load_model(tuned_study(16).model_uri)
    expected = model.predict(THETA)
    whole = THETA.astype(int)
    same: list[Any] = [whole, whole[["C", "R"]], whole.to_dict("list"), THETA.to_dict("list")]
    for given in same:
        np.testing.assert_array_equal(model.predict(given), expected)
    # Of one row single precision adds up in another order than of three.
    np.testing.assert_array_equal(model.predict({"C": 10_000, "R": 1}), model.predict(THETA[:1]))
    with pytest.raises(MlflowException, match="enforce schema"):
        model.predict(THETA[["R"]])
    with pytest.raises(ValueError, match="cold"):
        model.predict({"R": ["cold"], "C": [1e4]})


def test_a_moved_project_has_its_runs_and_models(copied: ProjectPaths, tmp_path: Path) -> None:
    moved = ProjectPaths(tmp_path / "moved away")
    shutil.move(copied.root, moved.root)
    mlflow.set_tracking_uri(moved.tracking_uri)
    assert mlflow.pyfunc.load_model(tuned_study(16).model_uri).predict(THETA).shape == (3, 25, 1)
    best = read_studies(moved)[0].best
    assert best is not None
    provenance = RunStore(moved).fetch(best.run_id, "provenance.json", tmp_path)
    assert provenance.stat().st_size > 1000
    Worker(moved, SPECS[0].name).run()  # what is finished stays finished


def test_an_artifact_outside_the_project_is_refused(tuned: ProjectPaths) -> None:
    inside = ProjectArtifacts("studies-project:/toy/a%20b", tuned.tracking_uri)
    assert inside.artifact_dir == str(tuned.artifacts.resolve() / "toy" / "a b")
    for uri in ("studies-project:/../../mlflow.db", "studies-project:/toy/%2e%2e/%2e%2e/x"):
        with pytest.raises(MlflowException, match="outside the project's artifacts"):
            ProjectArtifacts(uri, tuned.tracking_uri)


def test_processes_that_make_the_stores_at_once_do_not_get_in_each_other_s_way(tmp_path: Path) -> None:
    paths = ProjectPaths(tmp_path)
    queue = FORKED.SimpleQueue()
    other = FORKED.Process(target=make_stores, args=(paths, queue))
    other.start()
    while not paths.mlruns.exists():
        time.sleep(0.01)
    assert open_storage(paths).get_all_studies() == []
    assert RunStore(paths).experiment("toy") == queue.get()
