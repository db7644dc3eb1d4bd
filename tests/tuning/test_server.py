"""Tuning on a PostgreSQL server: workers side by side, one of them killed, and plain Optuna on its URL."""

import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import optuna
import pytest
from toy_study_for_tests import assert_mlflow_agrees, states, toy_study, workers_of

from simulation.errors import InputError, MachineError
from studies import patience
from studies.paths import ProjectPaths
from studies.server import give_identity
from studies.tracking.quiet_mlflow import connect
from studies.tracking.runs import RunStore
from studies.tuning.attempts import make_study, places
from studies.tuning.storage import open_storage, storage_of
from studies.tuning.study_results import of_project, read_studies
from studies.tuning.tune_studies import tune

if TYPE_CHECKING:
    from postgres_for_tests import PostgresServer

N_TRIALS = 8


@pytest.mark.slow
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


def test_a_server_that_does_not_answer_is_waited_for_and_reported_in_one_line(
    project: ProjectPaths, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    pytest.importorskip("psycopg")
    monkeypatch.setattr(patience, "WAIT_S", 1.5)
    paths = ProjectPaths(project.root, "postgresql://tester@127.0.0.1:1/studies")
    for opened in (open_storage, RunStore):
        with pytest.raises(
            MachineError, match=r'"127.0.0.1", port 1 failed: Connection refused.*type the comm'
        ):
            opened(paths)
    lines = [record.message for record in caplog.records if record.name == patience.__name__]
    assert len(lines) == 2
    assert "refused); waiting for it" in lines[0]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # threads' connections
def test_projects_that_begin_at_one_moment_share_an_empty_database(
    project: ProjectPaths, storage: str, tmp_path: Path
) -> None:
    def begun(number: int) -> str:
        paths = ProjectPaths(tmp_path / str(number), storage)
        paths.mlruns.mkdir(parents=True)
        open_storage(paths)
        return RunStore(paths).experiment(f"of {number}")

    with ThreadPoolExecutor(4) as pool:
        assert len(set(pool.map(begun, range(4)))) == 4


def test_a_database_that_is_not_there_is_reported(project: ProjectPaths, storage: str) -> None:
    with pytest.raises(InputError, match="nowhere"):
        open_storage(ProjectPaths(project.root, storage.rsplit("/", 1)[0] + "/nowhere"))


@pytest.mark.slow
def test_two_projects_of_one_name_in_one_database_find_their_own(
    project: ProjectPaths, storage: str, tmp_path: Path
) -> None:
    shutil.copytree(project.root, tmp_path / "other")
    both = [ProjectPaths(root, storage) for root in (project.root, tmp_path / "other")]
    champions = []
    for paths in both:
        give_identity(paths.root / "studies.toml")
        (spec,) = of_project([toy_study()], paths)
        (found,) = tune([spec], paths=paths, n_trials=1, n_jobs=1)
        version = connect(paths.tracking_uri).get_model_version_by_alias(spec.model_name, "champion")
        assert found.best is not None
        assert version.run_id == found.best.run_id
        champions.append(version.run_id)
        assert [one.spec for one in read_studies(paths)] == [spec]
        run = RunStore(paths).find(spec.label, {"best": "yes"})
        assert [one.info.run_id for one in run] == [version.run_id]
    assert champions[0] != champions[1]
    assert both[0].identity != both[1].identity
    # A copy keeps the identity, and finds what the first one has.
    shutil.copytree(project.root, tmp_path / "copy")
    copy = ProjectPaths(tmp_path / "copy", storage)
    assert [one.best.run_id for one in read_studies(copy) if one.best] == champions[:1]


def test_a_study_of_before_is_gone_on_with(project: ProjectPaths, storage: str) -> None:
    paths = ProjectPaths(project.root, storage)
    with storage_of(paths) as opened:
        make_study(opened, toy_study(), n_trials=1)
    give_identity(paths.root / "studies.toml")
    assert of_project([toy_study(), toy_study(24)], paths)[0] == toy_study()
    assert of_project([toy_study(24)], paths)[0].project == paths.identity
    assert [one.spec for one in read_studies(paths)] == [toy_study()]
