"""Databases that another program locks, and a server that is restarted while trials are trained."""

import logging
import os
import sqlite3
import threading
import time
from contextlib import closing
from typing import TYPE_CHECKING

import pytest
from optuna.trial import FrozenTrial
from toy_study_for_tests import assert_mlflow_agrees, essence, plain_study, states, toy_study, tuned_study

from simulation.errors import MachineError
from studies import patience
from studies.paths import ProjectPaths
from studies.tuning.tune_studies import tune
from studies.tuning.worker import Worker

if TYPE_CHECKING:
    from postgres_for_tests import PostgresServer

MLFLOW_WAITS_S = 20.0
# AWAY_S makes both outages longer, at most as long as `patience.WAIT_S`.
LOCKED_S = float(os.environ.get("AWAY_S", MLFLOW_WAITS_S + 2.0))
PAUSE_S = float(os.environ.get("AWAY_S", 4.0))
N_TRIALS = 3


@pytest.mark.slow
def test_a_store_that_another_program_locks_for_long_loses_no_trial(
    project: ProjectPaths, caplog: pytest.LogCaptureFixture
) -> None:
    few = toy_study().settings | {"max_epochs": 4, "patience": 4}
    spec = toy_study(settings=few)
    tune([spec], paths=project, n_trials=1, n_jobs=1, until_s=0.0)
    is_locked = threading.Event()

    def lock() -> None:
        with closing(sqlite3.connect(project.tracking_database, isolation_level=None)) as other:
            other.execute("begin immediate")
            is_locked.set()
            time.sleep(LOCKED_S)
            other.execute("rollback")

    worker = Worker(project, spec.name)
    thread = threading.Thread(target=lock)
    thread.start()
    is_locked.wait()
    with caplog.at_level(logging.WARNING, "studies.patience"):
        worker.run()
    thread.join()
    lines = [record.message for record in caplog.records if record.name == patience.__name__]
    assert lines == ["another program locks the SQLite database; waiting for it, 120 s at most"]
    assert states(plain_study(project, spec.name).get_trials()) == ["COMPLETE"]
    tune([spec], paths=project, n_trials=1, n_jobs=1)
    assert_mlflow_agrees(project, spec.label, spec.name)


def test_a_store_that_stays_locked_ends_in_one_line(
    copied: ProjectPaths, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(patience, "WAIT_S", 0.0)
    file = copied.tracking_database
    with closing(sqlite3.connect(file)) as other, closing(sqlite3.connect(file, timeout=0.0)) as own:
        other.execute("begin exclusive")
        with pytest.raises(MachineError, match=r"another program locks .* type the command again"):
            patience.waited_for(own.execute, "create table mine (x int)")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # connections that were cut
def test_a_server_may_be_restarted_while_trials_are_trained(
    project: ProjectPaths, tuned: ProjectPaths, storage: str, postgres_server: "PostgresServer"
) -> None:
    paths, spec = ProjectPaths(project.root, storage), tuned_study(16)
    n_restarts = 0

    def restart(_: object, trials: list[FrozenTrial]) -> None:
        nonlocal n_restarts
        if not n_restarts and any(trial.state.name == "RUNNING" for trial in trials):
            postgres_server.restart(PAUSE_S)
            n_restarts += 1

    (found,) = tune([spec], paths=paths, n_trials=N_TRIALS, n_jobs=1, on_trials=restart)
    assert n_restarts == 1
    assert found.n_ended == N_TRIALS
    on_server = essence(plain_study(paths, spec.name))
    assert on_server == essence(plain_study(tuned, spec.name))[:N_TRIALS]
    assert_mlflow_agrees(paths, spec.label, spec.name)
