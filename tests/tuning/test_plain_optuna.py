"""What a user does through plain Optuna stays and counts, and is never waited for."""

from datetime import datetime, timedelta

import numpy as np
import optuna
import pytest
from optuna.trial import TrialState, create_trial
from toy_study_for_tests import (
    N_TUNED,
    SPECS,
    plain_study,
    runs_of,
    states,
    tuned_study,
)

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.tracking.quiet_mlflow import connect
from studies.tracking.runs import RunStore, load_surrogate
from studies.tuning.study_results import read_studies
from studies.tuning.tune_studies import tune
from studies.tuning.worker import Worker


def test_added_and_enqueued_trials_and_attributes_stay_and_count(copied: ProjectPaths) -> None:
    spec = tuned_study(16)
    study = plain_study(copied, spec.name)
    distributions, params = study.best_trial.distributions, {"n_latent": 5, "n_hidden": 17, "beta": 77.0}
    study.set_user_attr("mine", "kept")
    asked = study.ask()  # by a program that takes its time
    study.enqueue_trial(params, user_attrs={"why": "a guess"})
    study.add_trial(
        create_trial(params=params, distributions=distributions, value=1e-6, user_attrs={"mine": 1})
    )
    forgotten = create_trial(state=TrialState.RUNNING)
    forgotten.datetime_start = datetime.now() - timedelta(hours=1)
    study.add_trial(forgotten)
    n_before = len(study.trials)
    assert n_before == N_TUNED + 4

    tune([spec], paths=copied, n_trials=n_before + 2, n_jobs=1, until_s=0.0)
    Worker(copied, spec.name).run()  # in this process: another one's start takes seconds
    (found,) = tune([spec], paths=copied, n_trials=n_before + 2, n_jobs=1)

    trials = study.get_trials()
    assert len(trials) == n_before + 2
    assert study.user_attrs["mine"] == "kept"
    other, enqueued, added, left = trials[N_TUNED:n_before]
    assert (other.number, other.state, left.state) == (asked.number, TrialState.RUNNING, TrialState.RUNNING)
    assert enqueued.state.is_finished()
    assert enqueued.params == params
    assert (added.value, added.user_attrs) == (1e-6, {"mine": 1})
    assert enqueued.user_attrs["why"] == "a guess"
    assert set(states(trials[n_before:])) <= {"COMPLETE", "PRUNED"}
    # What was not trained here has no surrogate to offer.
    assert found.best is not None
    assert found.best.run_id
    assert found.count("running") == 2
    assert not [run for run in runs_of(copied, spec.label) if run.info.status == "RUNNING"]


GOOD = {"n_latent": 5, "n_hidden": 17, "beta": 77.0}


def test_an_enqueued_mistake_fails_its_trial_with_a_reason_and_no_other(copied: ProjectPaths) -> None:
    mistakes = {
        "beta = 'ten' is no value of search.beta": {**GOOD, "beta": "ten"},
        "n_latent = 5.5 is no value of search.n_latent": {**GOOD, "n_latent": 5.5},
        "n_hidden = 4000 is no value of search.n_hidden": {**GOOD, "n_hidden": 4000},
        "beta = None is no value of search.beta": {**GOOD, "beta": None},
        "'n_latnt' is not searched; add it to [tuning.search]": {"n_latnt": 5},
    }
    spec = tuned_study(16)
    study = plain_study(copied, spec.name)
    for params in mistakes.values():
        study.enqueue_trial(params)
    n_trials = N_TUNED + len(mistakes) + 1
    tune([spec], paths=copied, n_trials=n_trials, n_jobs=1, until_s=0.0)
    Worker(copied, spec.name).run()
    *refused, other = study.get_trials()[N_TUNED:]
    assert [one.state for one in refused] == [TrialState.FAIL] * len(mistakes)
    said = [one.user_attrs["reason"] for one in refused]
    assert said == [f"its enqueued values are refused: {one}" for one in mistakes]
    assert other.state in (TrialState.COMPLETE, TrialState.PRUNED)
    # Later commands have nothing to do, and read what is there.
    (found,) = tune([spec], paths=copied, n_trials=n_trials, n_jobs=1)
    assert found.count("failed") == len(mistakes)
    assert len(study.get_trials()) == n_trials
    assert next(one.summary().n_failed for one in read_studies(copied)) == len(mistakes)


def test_added_trials_do_not_count_for_the_rate_of_trials(copied: ProjectPaths) -> None:
    spec = tuned_study(16)
    study = plain_study(copied, spec.name)
    before = next(one for one in read_studies(copied) if one.spec.name == spec.name)
    distributions = study.best_trial.distributions
    study.add_trials([create_trial(params=GOOD, distributions=distributions, value=1.0) for _ in range(50)])
    after = next(one for one in read_studies(copied) if one.spec.name == spec.name)
    assert after.n_ended == before.n_ended + 50
    assert after.trials_per_h == before.trials_per_h == before.summary().trials_per_h
    assert before.trials_per_h == pytest.approx(3600.0 * N_TUNED / before.wall_s)


@pytest.mark.parametrize("n_train", [16, 24])
def test_a_best_run_that_was_deleted_is_named_and_work_goes_on(copied: ProjectPaths, n_train: int) -> None:
    spec, said = tuned_study(n_train), list[str]()
    best = next(one.best for one in read_studies(copied) if one.spec.name == spec.name)
    assert best is not None
    runs = RunStore(copied)
    runs.client.delete_run(best.run_id)
    tune([spec], paths=copied, n_trials=N_TUNED, n_jobs=1, on_warning=said.append)
    (line,) = said
    assert line.endswith(f"mlflow runs restore --run-id {best.run_id}")
    # What is recommended instead is there and can be loaded.
    second = next(one.best for one in read_studies(copied) if one.spec.name == spec.name)
    if second is None:
        assert "no other trial has weights" in line
    else:
        assert f"trial {second.number} takes its place" in line
        assert second.run_id != best.run_id
        assert champion(copied, spec.model_name) == second.run_id
        assert load_surrogate(runs, second.run_id).predict(np.array([[1.0, 1e4]])).shape == (1, 25, 1)
    # Its owner has it back, and the next command marks and registers it again.
    runs.client.restore_run(best.run_id)
    tune([spec], paths=copied, n_trials=N_TUNED, n_jobs=1, on_warning=said.append)
    assert said == [line]
    assert champion(copied, spec.model_name) == best.run_id


def champion(paths: ProjectPaths, name: str) -> str | None:
    return connect(paths.tracking_uri).get_model_version_by_alias(name, "champion").run_id


def test_what_its_owner_deletes_in_other_programs_does_not_end_the_work(copied: ProjectPaths) -> None:
    spec, said = tuned_study(16), list[str]()
    client = connect(copied.tracking_uri)
    client.delete_registered_model(spec.model_name)
    (found,) = tune([spec], paths=copied, n_trials=N_TUNED, n_jobs=1, on_warning=said.append)
    assert found.best is not None
    assert champion(copied, spec.model_name) == found.best.run_id
    client.delete_model_version(spec.model_name, "1")
    client.delete_experiment(RunStore(copied).experiment(spec.label))
    tune([spec], paths=copied, n_trials=N_TUNED, n_jobs=1, on_warning=said.append)
    assert champion(copied, spec.model_name) == found.best.run_id
    assert len(runs_of(copied, spec.label, role="study", study=spec.name)) == 1
    optuna.delete_study(study_name=spec.name, storage=copied.optuna_url)
    (anew,) = tune([spec], paths=copied, n_trials=1, n_jobs=1, on_warning=said.append)
    assert [trial.number for trial in anew.trials] == [0]
    assert anew.best is not None
    assert champion(copied, spec.model_name) == anew.best.run_id
    marked = runs_of(copied, spec.label, best="yes", n_train="16")
    assert [run.info.run_id for run in marked] == [anew.best.run_id]
    assert said == []


def test_studies_of_other_programs_are_left_alone(copied: ProjectPaths) -> None:
    other = optuna.create_study(storage=copied.optuna_url, study_name="other")
    other.optimize(lambda trial: trial.suggest_float("x", 0.0, 1.0), n_trials=1)
    names = [one.spec.name for one in read_studies(copied)]
    assert names == [spec.name for spec in SPECS]
    with pytest.raises(InputError, match="'other' was not made by this program"):
        Worker(copied, "other")
    with pytest.raises(InputError, match="there is no study 'missing'"):
        Worker(copied, "missing")
