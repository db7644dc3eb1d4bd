"""The mean of several trials and PCA + GP as the best surrogate of a size: one model, whoever asks."""

import shutil
from dataclasses import replace
from pathlib import Path

import mlflow
import numpy as np
import pandas as pd
import pytest
from toy_study_for_tests import LABEL, N_TUNED, plain_study, runs_of, tuned_study

from pelsvae.mean_surrogate import MeanSurrogate
from studies.paths import ProjectPaths
from studies.project import best_blocks, best_document, read_project, status_document
from studies.results.trials import TunedStudy
from studies.tracking.quiet_mlflow import connect
from studies.tracking.runs import RunStore, load_surrogate
from studies.tuning.study_results import latest_studies, read_studies
from studies.tuning.trial_training import errors_by_name, load_data
from studies.tuning.tune_studies import tune

THETA = pd.DataFrame({"R": [1.0, 2.0, 3.0], "C": [1e4, 2e4, 3e4]})
SPEC = replace(tuned_study(16), settings=tuned_study(16).settings | {"max_epochs": 150, "patience": 150})
"""Trained long enough that no trial alone is the best mean."""


@pytest.fixture(scope="module")
def project(template: Path, tmp_path_factory: pytest.TempPathFactory) -> ProjectPaths:
    """A project with a study of four trials, without PCA + GP, which is best of all here."""
    root = tmp_path_factory.mktemp("mean") / "project"
    shutil.copytree(template, root)
    paths = ProjectPaths(root)
    tune([SPEC], paths=paths, n_trials=4, n_jobs=2, n_parallel=2)
    return paths


def found_in(paths: ProjectPaths) -> TunedStudy:
    return latest_studies(read_studies(paths, label=LABEL))[16, False]


def test_the_mean_errs_less_than_each_of_its_parts(project: ProjectPaths) -> None:
    found = found_in(project)
    best, trial = found.best, found.best_trial
    assert best is not None
    assert trial is not None
    assert trial.value is not None
    assert best.value is not None
    assert len(best.parts) > 1
    assert best.value <= 0.98 * trial.value
    assert best.value < min(part.metrics["val/mae"] for part in best.parts)
    assert sum(part.share for part in best.parts) == pytest.approx(1.0)
    surrogate = load_surrogate(RunStore(project), best.run_id)
    assert isinstance(surrogate, MeanSurrogate)
    theta, y = load_data(SPEC, project)["test"]
    errors = errors_by_name("test", surrogate.predict(theta), y, SPEC)
    assert errors["test/mae"] == best.metrics["test/mae"]


@pytest.mark.filterwarnings("ignore")  # MLflow's of its own dependencies
def test_it_is_one_registered_model(project: ProjectPaths) -> None:
    best = found_in(project).best
    assert best is not None
    version = connect(project.tracking_uri).get_model_version_by_alias(SPEC.model_name, "champion")
    assert version.run_id == best.run_id
    assert version.description.startswith("Mean of ")
    (run,) = runs_of(project, LABEL, best="yes", n_train="16")
    assert (run.info.run_id, run.data.tags["role"]) == (best.run_id, "mean")
    assert run.data.metrics["val/mae"] == best.value
    mlflow.set_tracking_uri(project.tracking_uri)
    predicted = mlflow.pyfunc.load_model(SPEC.model_uri).predict(THETA)
    same = load_surrogate(RunStore(project), best.run_id).predict(THETA.to_numpy())
    np.testing.assert_array_equal(predicted, same)


def test_its_page_shows_the_curve_of_its_largest_network(project: ProjectPaths) -> None:
    best = found_in(project).best
    assert best is not None
    client = connect(project.tracking_uri)
    shown = client.get_metric_history(best.run_id, "leading/validation_mae")
    largest = max(best.parts, key=lambda part: part.share)
    assert len(shown) >= 5
    own = client.get_metric_history(largest.run_id, "curve/validation_mae")
    assert [(one.step, one.value) for one in shown] == [(one.step, one.value) for one in own]


def test_every_table_names_it_as_what_it_is(project: ProjectPaths) -> None:
    best, read = found_in(project).best, read_project(project)
    assert best is not None
    (size,) = best_document(read)["sizes"]
    (of_status,) = (one for one in status_document(read)["studies"] if not one["is_baseline"])
    for one in (size, of_status):
        assert one["model"] == best.model
        assert [part["share"] for part in one["parts"]] == [part.share for part in best.parts]
        assert one["run_id"] == best.run_id
    table, sentence = best_blocks(read)[1:3]
    assert f"mean of {len(best.parts)}" in str(table)
    for part in best.parts:
        assert part.name in str(sentence)
        assert f"({part.metrics['test/mae']:.3g})" in str(sentence)


def test_the_same_candidates_give_no_second_mean(project: ProjectPaths) -> None:
    before = found_in(project).best
    tune([SPEC], paths=project, n_trials=4, n_jobs=1)
    assert found_in(project).best == before
    assert len(runs_of(project, LABEL, role="mean")) == 1


def test_one_surrogate_stays_where_a_mean_is_hardly_better(copied: ProjectPaths) -> None:
    found = latest_studies(read_studies(copied, label=LABEL))[16, False]
    assert found.mean is not None
    assert found.best_trial is not None
    for gain, is_mean in ((0.019, False), (0.021, True)):
        metrics = found.mean.metrics | {"val/mae": (1.0 - gain) * (found.best_trial.value or 0.0)}
        best = replace(found, mean=replace(found.mean, metrics=metrics)).best
        assert best is not None
        assert bool(best.parts) == is_mean


def test_pca_gp_is_the_best_where_no_share_of_a_network_helps(tuned: ProjectPaths) -> None:
    found = latest_studies(read_studies(tuned, label=LABEL))
    best, beside = found[16, False].best, found[16, True].best
    assert best is not None
    assert beside is not None
    assert best.model == "PCA + GP"
    assert [part.run_id for part in best.parts] == [beside.run_id]
    assert (best.value, best.metrics) == (beside.value, beside.metrics)
    assert best.params == {}


def test_a_deleted_mean_gives_way_to_its_best_trial(copied: ProjectPaths) -> None:
    spec, said = tuned_study(16), list[str]()
    found = latest_studies(read_studies(copied, label=LABEL))[16, False]
    assert found.best is not None
    assert found.best.parts
    runs = RunStore(copied)
    runs.client.delete_run(found.best.run_id)
    (now,) = tune([spec], paths=copied, n_trials=N_TUNED, n_jobs=1, on_warning=said.append)
    assert now.best == found.best_trial
    (line,) = said
    assert line.endswith(f"mlflow runs restore --run-id {found.best.run_id}")
    assert plain_study(copied, spec.name).user_attrs["gone"] == [found.best.run_id]
