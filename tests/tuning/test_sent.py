"""Runs on a real MLflow server: equal to those of the project, once each, also after outages and kills."""

import shutil
import time
from collections.abc import Iterator
from contextvars import Context
from dataclasses import replace
from pathlib import Path
from typing import Any

import mlflow
import numpy as np
import optuna
import pandas as pd
import pytest
from mlflow_server_for_tests import NAME, PASSWORD, MlflowServer, WithoutRegistry
from mlflow_store_for_tests import give_store
from toy_study_for_tests import LABEL, assert_mlflow_agrees, runs_of, toy_study, tuned_study

from simulation.file_lock import FileLock
from studies.paths import ProjectPaths
from studies.server import Server, give_identity
from studies.tracking.outbox import Outbox, ServerAwayError
from studies.tracking.quiet_mlflow import connect
from studies.tracking.runs import RunStore, load_surrogate
from studies.tracking.sending import begin_sending, runs_sent
from studies.tracking.sent_runs import sent_runs
from studies.tracking.shared_names import PROJECT
from studies.tracking.study_tags import RUN, TRACKING
from studies.tuning.study_results import read_studies
from studies.tuning.tune_studies import tune

pytestmark = pytest.mark.filterwarnings("ignore")  # MLflow's of its own dependencies, used plainly here
THETA = pd.DataFrame({"R": [1.0, 2.0], "C": [1e4, 2e4]})


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[MlflowServer]:
    """A server without a password."""
    made = MlflowServer(tmp_path_factory.mktemp("server"))
    yield made
    made.close()


def with_server(paths: ProjectPaths, uri: str, **more: Any) -> ProjectPaths:
    """Return a project whose runs were made for a server; none was sent yet."""
    give_identity(paths.root / "studies.toml")
    with_server = replace(paths, server=Server(uri, uri, **more))
    client = connect(paths.tracking_uri)
    for run in runs_of(paths, LABEL):
        client.set_tag(run.info.run_id, TRACKING, uri)
    return with_server


def send(paths: ProjectPaths) -> list[str]:
    """Send what is missing, and return what was said."""
    assert paths.server is not None
    said: list[str] = []
    Outbox(paths, paths.server, said.append).send()
    return said


def runs_there(uri: str, paths: ProjectPaths) -> dict[str, Any]:
    """Return the runs of a project on a server by their ids in the project; none is there twice."""
    client = mlflow.MlflowClient(uri, uri)
    everywhere = [one.experiment_id for one in client.search_experiments()]
    mine = f"tags.`studies.project` = '{paths.identity}'"
    found = client.search_runs(everywhere, mine, max_results=5000) if everywhere else []
    assert len({run.data.tags[RUN] for run in found}) == len(found)
    return {run.data.tags[RUN]: run for run in found}


def assert_equal_there(uri: str, paths: ProjectPaths) -> None:
    """Check that a server has all runs of a project as the project has them."""
    own, client = connect(paths.tracking_uri), mlflow.MlflowClient(uri, uri)
    there = runs_there(uri, paths)
    here = {run.info.run_id: run for run in runs_of(paths, LABEL)}
    assert there.keys() == here.keys()
    for run_id, run in here.items():
        sent = there[run_id]
        assert sent.info.status == run.info.status
        assert (sent.info.start_time, sent.info.end_time) == (run.info.start_time, run.info.end_time)
        assert sent.data.params == run.data.params
        assert sent.data.metrics == run.data.metrics
        changed = {TRACKING, RUN, PROJECT, "mlflow.parentRunId"}
        assert {k: v for k, v in sent.data.tags.items() if k not in changed} == {
            k: v for k, v in run.data.tags.items() if k not in changed
        }
        if parent := run.data.tags.get("mlflow.parentRunId"):
            assert sent.data.tags["mlflow.parentRunId"] == there[parent].info.run_id
        for name in run.data.metrics:
            curves = [c.get_metric_history(i, name) for c, i in ((own, run_id), (client, sent.info.run_id))]
            mine, theirs = ([(point.step, point.value, point.timestamp) for point in one] for one in curves)
            assert sorted(theirs) == sorted(mine)
        names = [
            {one.path for one in c.list_artifacts(i)} for c, i in ((own, run_id), (client, sent.info.run_id))
        ]
        assert names[0] == names[1]


@pytest.mark.slow
def test_runs_curves_artifacts_and_models_are_on_the_server(
    copied: ProjectPaths, server: MlflowServer
) -> None:
    paths = with_server(copied, server.uri, tags=(("team", "halls"),))
    assert send(paths) == []
    there = runs_there(server.uri, paths)
    assert {run.data.tags.pop("team") for run in there.values()} == {"halls"}
    client = connect(copied.tracking_uri)
    for run in runs_of(copied, LABEL):  # so that both have the same tags
        client.set_tag(run.info.run_id, "team", "halls")
    assert_equal_there(server.uri, paths)
    assert send(paths) == []
    assert_equal_there(server.uri, paths)
    best = [run for run in there.values() if run.data.tags.get("best") == "yes"]
    assert sorted(run.data.params["n_train"] for run in best) == ["16", "24"]
    mlflow.set_tracking_uri(server.uri)
    predicted = mlflow.pyfunc.load_model(tuned_study(16).model_uri).predict(THETA)
    found = next(one.best for one in read_studies(paths) if one.spec == tuned_study(16))
    sent = sent_runs(paths)
    assert found is not None
    assert sent is not None
    assert sent.id_of(found.run_id) in {run.info.run_id for run in best}
    same = load_surrogate(RunStore(copied), found.run_id).predict(THETA.to_numpy())
    np.testing.assert_array_equal(predicted, same)


@pytest.mark.slow
def test_a_list_of_sent_runs_that_is_lost_doubles_nothing(copied: ProjectPaths, server: MlflowServer) -> None:
    paths = with_server(copied, server.uri)
    send(paths)
    shutil.rmtree(paths.mlruns / "sent")
    assert send(paths) == []
    assert_equal_there(server.uri, paths)
    client = mlflow.MlflowClient(server.uri, server.uri)
    sent = sent_runs(paths)
    assert sent is not None
    for model in sent.models.values():
        assert len(client.search_model_versions(f"name = '{model['name']}'")) == 1


@pytest.mark.slow
def test_a_command_ends_once_the_sender_of_another_one_has_sent_its_runs(
    copied: ProjectPaths, server: MlflowServer
) -> None:
    paths, said = with_server(copied, server.uri), list[str]()
    client = connect(copied.tracking_uri)
    run_id = runs_of(copied, LABEL)[0].info.run_id

    def note() -> None:
        with runs_sent(said.append):
            begin_sending(paths)
            client.set_tag(run_id, "noted", "while another command works")

    with runs_sent(said.append):
        begin_sending(paths)
        lock = FileLock(paths.mlruns / ".sent.lock")
        while lock.try_acquire():  # until the first command's sender has it
            lock.release()
            time.sleep(0.2)
        Context().run(note)
        assert runs_there(server.uri, paths)[run_id].data.tags["noted"] == "while another command works"
    assert said == []
    assert_equal_there(server.uri, paths)


@pytest.mark.slow
def test_two_projects_of_one_name_find_their_own(
    copied: ProjectPaths, server: MlflowServer, tmp_path: Path
) -> None:
    shutil.copytree(copied.root, tmp_path / "other")
    one, other = with_server(copied, server.uri), with_server(ProjectPaths(tmp_path / "other"), server.uri)
    assert send(one) == send(other) == []
    assert_equal_there(server.uri, one)
    assert_equal_there(server.uri, other)
    names = [
        {model["name"] for model in sent.models.values()} for p in (one, other) if (sent := sent_runs(p))
    ]
    assert len(names[0]) == len(names[1]) == 2
    assert not names[0] & names[1]


@pytest.mark.slow
def test_a_run_that_its_owner_deleted_there_is_not_made_again(
    copied: ProjectPaths, server: MlflowServer
) -> None:
    paths = with_server(copied, server.uri)
    send(paths)
    client, store = mlflow.MlflowClient(server.uri, server.uri), RunStore(paths)
    run = next(run for run in runs_of(paths, LABEL, best="yes") if run.data.params["n_train"] == "16")
    client.delete_run(runs_there(server.uri, paths)[run.info.run_id].info.run_id)
    store.log(run.info.run_id, tags={"note": "of later"})
    (line,) = send(paths)
    assert "was deleted on" in line
    assert send(paths) == []
    assert run.info.run_id not in runs_there(server.uri, paths)


@pytest.mark.slow
def test_a_server_without_a_registry_has_the_runs(copied: ProjectPaths, server: MlflowServer) -> None:
    proxy = WithoutRegistry(server.uri)
    paths = with_server(copied, proxy.uri)
    said = send(paths)
    proxy.close()
    assert said == [f"{proxy.uri} has no model registry: models stay in the project"]
    assert_equal_there(server.uri, paths)


@pytest.mark.slow
def test_a_killed_server_costs_no_trial_and_no_run(project: ProjectPaths, server: MlflowServer) -> None:
    paths = with_server(project, server.uri)
    spec, said, kills = toy_study(), [], []

    def kill_once(_: object, trials: list[optuna.trial.FrozenTrial]) -> None:
        if not kills and sum(trial.state.is_finished() for trial in trials) >= 2:
            server.kill()
            kills.append(1)

    with runs_sent(said.append):
        tune([spec], paths=paths, n_trials=5, n_jobs=1, on_trials=kill_once)
    assert kills
    (line,) = said
    assert "not on http://127.0.0.1" in line
    assert "sent by the next command" in line
    assert_mlflow_agrees(paths, LABEL, spec.name)
    server.start()
    with runs_sent(said.append):
        begin_sending(paths)
    assert len(said) == 1, said
    assert_equal_there(server.uri, paths)


@pytest.mark.slow
def test_a_server_with_a_password(
    copied: ProjectPaths, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("flask_wtf")  # of the extra mlflow[auth]
    guarded = MlflowServer(tmp_path_factory.mktemp("guarded"), is_guarded=True)
    try:
        client = connect(copied.tracking_uri)
        study, trial, *others = runs_of(copied, LABEL)
        for run in others:  # a call takes 0.3 s
            client.delete_run(run.info.run_id)
        paths = with_server(copied, guarded.uri)
        with pytest.raises(ServerAwayError, match="401"):
            send(paths)
        monkeypatch.setenv("MLFLOW_TRACKING_USERNAME", NAME)
        monkeypatch.setenv("MLFLOW_TRACKING_PASSWORD", PASSWORD)
        assert send(paths) == []
        assert runs_there(guarded.uri, paths).keys() == {study.info.run_id, trial.info.run_id}
    finally:
        guarded.close()
    kept = "\n".join(file.read_text(errors="replace") for file in (paths.mlruns / "sent").iterdir())
    assert PASSWORD not in kept


@pytest.mark.slow
def test_a_server_on_postgresql_has_the_same_runs(
    copied: ProjectPaths, storage: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    database = storage.replace("postgresql:", "postgresql+psycopg:", 1)
    company = MlflowServer(tmp_path_factory.mktemp("company"), database=database)
    try:
        paths = with_server(copied, company.uri)
        assert send(paths) == []
        assert_equal_there(company.uri, paths)
        shutil.rmtree(paths.mlruns / "sent")
        assert send(paths) == []
        assert_equal_there(company.uri, paths)
    finally:
        company.close()


def test_another_sqlite_file_is_a_server_too(
    copied: ProjectPaths, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    give_store(tmp_path / "mine")
    uri = f"sqlite:///{tmp_path}/mine/mlruns/mlflow.db"
    paths = with_server(copied, uri)
    monkeypatch.chdir(tmp_path)  # where MLflow puts the files of such a store
    assert send(paths) == []
    assert_equal_there(uri, paths)
