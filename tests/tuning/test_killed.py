"""Kills at any moment: every place ends once, with the numbers of the undisturbed study."""

import random
import sqlite3
import threading
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace

import psutil
import pytest
from forked_for_tests import FORKED, is_killed, run_command
from optuna.trial import TrialState
from toy_study_for_tests import (
    LABEL,
    N_TUNED,
    assert_mlflow_agrees,
    essence,
    plain_study,
    runs_of,
    states,
    toy_study,
    tuned_study,
    workers_of,
)

from studies.paths import ProjectPaths
from studies.tuning.attempts import places
from studies.tuning.tune_studies import tune
from studies.tuning.worker import Worker

PATIENCE_S = 600.0
FINISHED = {"COMPLETE", "PRUNED", "FAIL"}


def wait_until(is_so: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < deadline
        time.sleep(0.1)


def assert_each_place_ended(paths: ProjectPaths, name: str, n: int) -> None:
    trials = plain_study(paths, name).get_trials()
    assert set(states(trials)) <= FINISHED
    assert len(places(trials)) == n
    # What was killed on the way has failed, and was repeated.
    repeated = {number for trial in trials for number in trial.system_attrs.get("retry_history", [])}
    assert {trial.number for trial in trials if trial not in places(trials)} == repeated


@pytest.mark.slow
def test_a_worker_may_be_killed_at_any_of_its_writes(project: ProjectPaths) -> None:
    draw = random.Random(28)
    first = [[n] for n in (1, 7)]  # the trial is leased, gets its hyperparameters
    rest = [[draw.randrange(9, 60)]]
    twice = [[30, 1]]  # the retry dies as well, while it begins
    kills = [*first, *rest, *twice]
    few = toy_study().settings | {"max_epochs": 4, "patience": 4}
    startup = {"name": "TPESampler", "n_startup_trials": 1}
    # The label changes no trial.
    specs = [
        replace(toy_study(settings=few, sampler=startup), label=f"toy-{n}") for n in range(len(kills) + 1)
    ]
    tune(specs, paths=project, n_trials=2, n_jobs=1, until_s=0.0)
    Worker(project, specs[-1].name).run()
    undisturbed = essence(plain_study(project, specs[-1].name))
    assert [row[0] for row in undisturbed] == ["COMPLETE"] * 2
    for spec, writes in zip(specs, kills, strict=False):
        for n_writes in writes:
            assert is_killed(project, spec.name, n_writes), kills
    for spec in specs:
        Worker(project, spec.name).run()
        assert_each_place_ended(project, spec.name, 2)
        assert essence(plain_study(project, spec.name)) == undisturbed, kills
    last = specs[-2:]  # to be brief: it registers a model of each study
    tune(last, paths=project, n_trials=2, n_jobs=1)
    for spec in last:
        assert_mlflow_agrees(project, spec.label, spec.name)


@pytest.mark.slow
def test_a_killed_command_goes_on(project: ProjectPaths, tuned: ProjectPaths) -> None:
    """Ctrl-C ends a command in tests/cli/test_cli_resume.py."""
    spec = tuned_study(16)

    def n_ended() -> int:
        """Read as any program may; Optuna would take the processor."""
        with closing(sqlite3.connect(f"file:{project.optuna_database}?mode=ro", uri=True)) as database:
            states = "('COMPLETE', 'PRUNED', 'FAIL')"
            (n,) = database.execute(f"select count(*) from trials where state in {states}").fetchone()
        return int(n)

    command = FORKED.Process(target=run_command, args=(project, spec, N_TUNED))
    command.start()
    wait_until(lambda: n_ended() >= 2 or not command.is_alive())
    assert command.pid is not None
    workers = workers_of(command.pid)
    assert len(workers) == 1
    command.kill()
    command.join()
    assert not psutil.wait_procs(workers, timeout=100.0)[1], "a worker outlives its command"
    assert len(places(plain_study(project, spec.name).get_trials())) < N_TUNED
    Worker(project, spec.name).run()
    assert_each_place_ended(project, spec.name, N_TUNED)
    assert essence(plain_study(project, spec.name)) == essence(plain_study(tuned, spec.name))


@pytest.mark.slow
def test_a_trial_that_kills_its_worker_again_and_again_fails(project: ProjectPaths) -> None:
    spec = toy_study()
    tune([spec], paths=project, n_trials=1, n_jobs=1, until_s=0.0)
    for _ in range(6):
        assert is_killed(project, spec.name, 30)
    Worker(project, spec.name).run()
    trials = plain_study(project, spec.name).get_trials()
    assert states(trials) == ["FAIL"] * 6
    assert len(places(trials)) == 1
    tune([spec], paths=project, n_trials=1, n_jobs=1)
    runs = runs_of(project, LABEL, role="trial")
    assert {run.info.status for run in runs} == {"FAILED"}
    assert {run.data.tags["reason"] for run in runs} == {"its worker died"}


def test_a_trial_that_another_process_ends_is_given_up(project: ProjectPaths) -> None:
    """As one whose worker stood still beyond the grace period."""
    spec = toy_study(settings=toy_study().settings | {"max_epochs": 5000, "patience": 5000}, max_trial_s=60.0)
    tune([spec], paths=project, n_trials=1, n_jobs=1, until_s=0.0)
    worker = threading.Thread(target=Worker(project, spec.name).run)
    worker.start()
    study = plain_study(project, spec.name)
    wait_until(lambda: study.trials[0].user_attrs.get("seed") is not None)
    study.tell(0, state=TrialState.FAIL)
    worker.join(PATIENCE_S)
    assert not worker.is_alive()
    assert states(study.get_trials()) == ["FAIL"]
