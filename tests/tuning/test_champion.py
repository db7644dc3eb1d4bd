"""Which surrogate is the best of a size: one answer for the alias, the tag, `best`, `status` and programs."""

from dataclasses import replace

import mlflow
import pytest
from toy_study_for_tests import LABEL, N_TUNED, SEARCH, plain_study, runs_of, tuned_study

from studies.paths import ProjectPaths
from studies.project import best_document, read_project, status_document
from studies.results.declaration import Declaration
from studies.results.trials import TunedStudy
from studies.tracking.quiet_mlflow import connect
from studies.tracking.runs import RunStore, register_best
from studies.tuning.study_results import latest_studies, read_studies
from studies.tuning.tune_studies import closed_studies, tune

EDITED = {**SEARCH, "beta": {"kind": "float", "low": 1.0, "high": 2.0, "log": True}}
"""A range that leaves out what was good."""


@pytest.fixture
def networks(project: ProjectPaths) -> ProjectPaths:
    """A project with one trained network, and no PCA + GP, which is better than these."""
    tune([tuned_study(16)], paths=project, n_trials=1, n_jobs=1)
    return project


def best_of_size(paths: ProjectPaths, n_train: int) -> TunedStudy:
    return latest_studies(read_studies(paths, label=LABEL))[n_train, False]


def assert_one_answer(paths: ProjectPaths, spec: Declaration) -> None:
    """Check that alias, tag, `best` and `status` name the same trial."""
    best = best_of_size(paths, spec.n_train).best
    assert best is not None
    version = connect(paths.tracking_uri).get_model_version_by_alias(spec.model_name, "champion")
    assert version.run_id == best.run_id
    assert [run.info.run_id for run in runs_of(paths, LABEL, best="yes", n_train=str(spec.n_train))] == [
        best.run_id
    ]
    project = read_project(paths)
    for size in (*best_document(project)["sizes"], *status_document(project)["studies"]):
        if size["n_train"] == spec.n_train and not size.get("is_baseline"):
            assert (size["run_id"], size["study"]) == (best.run_id, best.spec.name)
            assert size["model_uri"] == f"models:/{spec.model_name}/{version.version}"


def test_an_edited_range_does_not_make_a_worse_surrogate_the_best(networks: ProjectPaths) -> None:
    spec, said = tuned_study(16), list[str]()
    before = best_of_size(networks, 16).best
    assert before is not None
    edited = replace(spec, search=EDITED, settings=spec.settings | {"max_epochs": 1})
    (found,) = tune([edited], paths=networks, n_trials=1, n_jobs=1, on_news=said.append)
    (worse,) = found.of(edited.name).trials
    assert worse.value is not None
    assert before.value is not None
    assert worse.value > before.value
    assert found.best == before
    assert said == []
    assert_one_answer(networks, edited)
    assert closed_studies([edited], networks, 1) is not None
    # The study of this command is worked on by its own count of trials.
    assert (found.of(edited.name).n_ended, found.n_ended) == (1, 2)


def test_a_better_surrogate_takes_the_place_and_a_line_says_why(networks: ProjectPaths) -> None:
    spec, said = tuned_study(16), list[str]()
    longer = replace(spec, settings=spec.settings | {"max_epochs": 60, "patience": 60})
    (found,) = tune([longer], paths=networks, n_trials=1, n_jobs=1, on_news=said.append)
    assert found.best_trial is not None
    assert found.best_trial.spec == longer
    (line,) = said
    assert longer.name in line
    assert f"version 1 was: trial 0 of {spec.name}" in line
    version = connect(networks.tracking_uri).get_model_version_by_alias(spec.model_name, "champion")
    assert version.tags["promoted"] == line
    assert_one_answer(networks, longer)
    # The command of before finds the same one.
    tune([spec], paths=networks, n_trials=1, n_jobs=1, on_news=said.append)
    assert said == [line]
    assert_one_answer(networks, spec)


def test_a_trial_that_another_program_ended_in_an_earlier_study_is_registered_by_the_next_command(
    copied: ProjectPaths,
) -> None:
    spec = tuned_study(16)
    edited = replace(spec, search=EDITED, settings=spec.settings | {"max_epochs": 1})
    tune([edited], paths=copied, n_trials=1, n_jobs=1)
    plain_study(copied, spec.name).enqueue_trial({"n_latent": 5, "n_hidden": 17, "beta": 77.0})
    assert closed_studies([edited], copied, 1) is None


@pytest.mark.slow
def test_a_project_of_before_gets_one_answer_from_the_next_command(networks: ProjectPaths) -> None:
    spec = tuned_study(16)
    edited = replace(spec, search=EDITED, settings=spec.settings | {"max_epochs": 1})
    (found,) = tune([edited], paths=networks, n_trials=1, n_jobs=1)
    (worse,) = found.of(edited.name).trials
    register_best(RunStore(networks), worse)  # the alias went to the best of the latest study
    for name in (spec.name, edited.name):
        study = plain_study(networks, name)
        for attribute in ("versions", "mean"):
            study.set_user_attr(attribute, None)
    assert best_document(read_project(networks))["sizes"][0]["model_uri"] is None
    assert closed_studies([edited], networks, 1) is None
    tune([edited], paths=networks, n_trials=1, n_jobs=1)
    assert closed_studies([edited], networks, 1) is not None
    assert_one_answer(networks, edited)


def test_other_data_begin_anew(copied: ProjectPaths) -> None:
    spec = tuned_study(16)
    before = best_of_size(copied, 16).best
    assert before is not None
    changed = replace(spec, digests=spec.digests | {"case": "d" * 64})
    said = list[str]()
    (found,) = tune([changed], paths=copied, n_trials=1, n_jobs=1, on_news=said.append)
    assert found.best is not None
    assert found.best.spec == changed
    (line,) = said
    assert line.endswith("version 1 was: it is of other data, or it was deleted")
    listed = [one["study"] for one in status_document(read_project(copied))["studies"]]
    assert {before.spec.name, changed.name} <= set(listed)


@pytest.mark.filterwarnings("ignore")  # MLflow's of its own dependencies
def test_the_address_of_the_best_is_that_of_a_version(copied: ProjectPaths) -> None:
    (found,) = tune([tuned_study(16)], paths=copied, n_trials=N_TUNED, n_jobs=1)
    uri = found.model_uri
    assert uri == f"models:/{LABEL}-n0016/1"
    mlflow.set_tracking_uri(copied.tracking_uri)
    assert mlflow.pyfunc.load_model(uri).metadata.run_id == (found.best.run_id if found.best else "")
