"""Studies reach their trials, from the same configurations each time, and fail alone."""

import time
from collections.abc import Sequence
from typing import Any

import pytest
from forked_for_tests import FORKED, imports_of_worker, run_worker
from optuna.trial import TrialState
from toy_study_for_tests import (
    N_TUNED,
    SEARCH,
    SPECS,
    assert_mlflow_agrees,
    essence,
    plain_study,
    runs_of,
    states,
    toy_study,
    tuned_study,
)

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.results.declaration import Declaration
from studies.tuning.study_results import read_studies
from studies.tuning.tune_studies import closed_studies, tune
from studies.tuning.worker import Worker, main

FINISHED = {"COMPLETE", "PRUNED", "FAIL"}


def prepared(paths: ProjectPaths, spec: Declaration, n_trials: int) -> Worker:
    """Make a study and a worker for it in this process: a process's start takes seconds."""
    tune([spec], paths=paths, n_trials=n_trials, n_jobs=1, until_s=0.0)
    return Worker(paths, spec.name)


def test_a_worker_without_a_project_says_so_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("STUDIES_ROOT", "/nowhere")
    monkeypatch.setattr("sys.argv", ["worker", "office-quick/n0032"])
    assert main() == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "/nowhere" in line


def test_every_study_reaches_its_trials(tuned: ProjectPaths) -> None:
    for spec in SPECS:
        trials = plain_study(tuned, spec.name).get_trials()
        assert len(trials) == (1 if spec.is_baseline else N_TUNED)
        assert set(states(trials)) <= FINISHED
    assert_mlflow_agrees(tuned, SPECS[0].label, *(spec.name for spec in SPECS))


def test_trials_begin_with_the_default_and_the_sampler_proposes_most_although_some_were_pruned(
    tuned: ProjectPaths,
) -> None:
    for study in (one for one in read_studies(tuned) if not one.spec.is_baseline):
        first = study.trials[0]
        assert (first.proposed_by, first.state) == ("default", "complete")
        assert first.params == {"n_latent": 8, "n_hidden": 32, "beta": 10.0}  # clipped to the search space
        assert study.default is first
        assert study.count("pruned") >= 1
        assert 2 * study.n_proposed >= N_TUNED
        assert {trial.proposed_by for trial in study.trials} == {"default", "start-up", "TPESampler"}


@pytest.mark.slow
def test_more_trials_extend_a_study_as_if_it_had_been_asked_for_them_at_once(
    project: ProjectPaths, tuned: ProjectPaths
) -> None:
    spec = tuned_study(16)
    prepared(project, spec, 5).run()
    begun = essence(plain_study(project, spec.name))
    assert len(begun) == 5
    prepared(project, spec, N_TUNED).run()
    assert essence(plain_study(project, spec.name))[:5] == begun
    # That of `tuned` ran in another process, and beside another one.
    assert essence(plain_study(project, spec.name)) == essence(plain_study(tuned, spec.name))


@pytest.mark.slow
def test_fewer_trials_than_an_interrupted_study_wanted_end_there(project: ProjectPaths) -> None:
    spec = toy_study(16)
    prepared(project, spec, 6)
    prepared(project, spec, 2).run()
    (found,) = tune([spec], paths=project, n_trials=2, n_jobs=1)
    assert [trial.state for trial in found.trials] == ["complete"] * 2
    assert plain_study(project, spec.name).metric_names == ["val/mae"]
    prepared(project, spec, 3).run()
    assert len(plain_study(project, spec.name).trials) == 3


def test_a_finished_study_is_left_as_it_is(copied: ProjectPaths) -> None:
    before = {spec.name: plain_study(copied, spec.name).get_trials() for spec in SPECS}
    asked: list[Sequence[Any]] = []
    found = tune(
        SPECS, paths=copied, n_trials=N_TUNED, n_jobs=2, on_trials=lambda spec, _: asked.append(spec.name)
    )
    assert asked == []
    assert [study.spec.name for study in found] == [spec.name for spec in SPECS]
    assert {spec.name: plain_study(copied, spec.name).get_trials() for spec in SPECS} == before
    again = closed_studies(SPECS, copied, N_TUNED)
    assert again is not None
    assert [study.trials for study in again] == [study.trials for study in found]
    assert closed_studies(SPECS, copied, N_TUNED + 1) is None


def test_two_workers_of_a_study_run_no_trial_too_many(project: ProjectPaths) -> None:
    spec = toy_study(16)
    worker = prepared(project, spec, 5)
    other = FORKED.Process(target=run_worker, args=(project, spec.name))
    other.start()
    while "RUNNING" not in states(plain_study(project, spec.name).trials):
        time.sleep(0.01)
    worker.run()
    other.join()
    trials = plain_study(project, spec.name).get_trials()
    assert states(trials) == ["COMPLETE"] * 5
    assert len({trial.user_attrs["owner"]["pid"] for trial in trials}) == 2
    assert len({str(sorted(trial.params.items())) for trial in trials}) == 5
    (found,) = tune([spec], paths=project, n_trials=5, n_jobs=2, n_parallel=2)
    assert found.n_ended == 5
    assert_mlflow_agrees(project, spec.label, spec.name)


def test_a_worker_imports_little_itself(copied: ProjectPaths) -> None:
    answer = FORKED.SimpleQueue()
    worker = FORKED.Process(target=imports_of_worker, args=(copied, SPECS[0].name, answer))
    worker.start()
    assert len(answer.get()) < 100  # of 400 that opening both stores takes
    worker.join()


def test_a_diverging_trial_fails_with_its_reason_and_costs_no_other(project: ProjectPaths) -> None:
    # Only the enqueued trial takes a learning rate at which the loss is no number any more.
    rate = {"kind": "categorical", "choices": [0.005, 1e30]}
    sane = {"n_latent": 4, "n_hidden": 16, "beta": 10.0}
    enqueue = ({**sane, "learning_rate": 1e30}, {**sane, "learning_rate": 0.005})
    spec = toy_study(16, search={**SEARCH, "learning_rate": rate}, enqueue=enqueue)
    prepared(project, spec, 3).run()
    (found,) = read_studies(project)
    assert [trial.state for trial in found.trials] == ["complete", "failed", "complete"]
    assert [trial.proposed_by for trial in found.trials] == ["default", "profile", "profile"]
    reason = plain_study(project, spec.name).trials[1].user_attrs["reason"]
    assert reason.startswith("TrainingDiverged: ")
    assert not found.trials[1].metrics
    tune([spec], paths=project, n_trials=3, n_jobs=1)
    assert_mlflow_agrees(project, spec.label, spec.name)
    (run,) = runs_of(project, spec.label, trial_state="fail")
    assert run.data.tags["reason"] == reason
    assert not [name for name in run.data.metrics if name.startswith(("val/", "test/"))]


def test_a_trial_that_reaches_its_time_limit_counts_as_pruned(project: ProjectPaths) -> None:
    endless = toy_study(16).settings | {"max_epochs": 1_000_000, "patience": 1_000_000}
    spec = toy_study(16, settings=endless, max_trial_s=0.2)
    prepared(project, spec, 1).run()
    (trial,) = plain_study(project, spec.name).trials
    assert trial.state == TrialState.PRUNED
    assert trial.user_attrs["reason"].startswith("reached its limit of 0.2 s at epoch ")
    assert trial.value is not None


def test_changed_data_is_refused(project: ProjectPaths) -> None:
    digests = toy_study(16).digests | {"test": "0" * 64}
    with pytest.raises(InputError, match=r"test\.npz has changed since the study was declared"):
        tune([toy_study(16, digests=digests)], paths=project, n_trials=1, n_jobs=1)
