"""Tuning on a PostgreSQL server: workers side by side, one of them killed, and plain Optuna on its URL."""

import os
from typing import TYPE_CHECKING

import optuna
import pytest
from toy_study_for_tests import assert_mlflow_agrees, states, toy_study, workers_of

from simulation.errors import InputError, MachineError
from studies.paths import ProjectPaths
from studies.tuning.attempts import places
from studies.tuning.storage import open_storage
from studies.tuning.tune_studies import tune

if TYPE_CHECKING:
    from postgres_for_tests import PostgresServer

N_TRIALS = 8


def test_two_workers_one_killed_reach_the_trials(
    project: ProjectPaths, storage: str, postgres_server: "PostgresServer"
) -> None:
    paths = ProjectPaths(project.root, storage)
    spec = toy_study()
    n_killed = 0

    def kill_one(_: object, trials: list[optuna.trial.FrozenTrial]) -> None:
        nonlocal n_killed
        workers = workers_of(os.getpid())
        if not n_killed and len(workers) == 2 and any(trial.state.name == "RUNNING" for trial in trials):
            workers[0].kill()
            n_killed += 1

    (found,) = tune([spec], paths=paths, n_trials=N_TRIALS, n_jobs=2, n_parallel=2, on_trials=kill_one)
    assert n_killed == 1
    assert found.n_ended == N_TRIALS
    study = optuna.load_study(study_name=spec.name, storage=paths.optuna_url)
    trials = study.get_trials()
    assert set(states(trials)) <= {"COMPLETE", "FAIL"}
    assert states(places(trials)) == ["COMPLETE"] * N_TRIALS
    assert_mlflow_agrees(paths, spec.label, spec.name)
    schemas = postgres_server.execute(
        "select table_schema from information_schema.tables where table_name = 'alembic_version'",
        storage.rsplit("/", 1)[1],
    )
    assert sorted(schemas) == [("mlflow",), ("optuna",)]


def test_a_server_that_does_not_answer_is_reported_in_one_line(project: ProjectPaths) -> None:
    pytest.importorskip("psycopg")
    paths = ProjectPaths(project.root, "postgresql://tester@127.0.0.1:1/studies")
    with pytest.raises(MachineError, match=r"tester@127.*correct it or start it"):
        open_storage(paths)


def test_a_database_that_is_not_there_is_reported(project: ProjectPaths, storage: str) -> None:
    with pytest.raises(InputError, match="nowhere"):
        open_storage(ProjectPaths(project.root, storage.rsplit("/", 1)[0] + "/nowhere"))
