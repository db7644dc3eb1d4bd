"""Studies on a PostgreSQL server: shared by workers, which are killed at random, and restarted under them."""

import logging
import multiprocessing
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from lone_worker import work
from mlflow import MlflowClient
from optuna.trial import TrialState
from tuning_checks import essence, ignore, in_optuna, records_of

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.tracking.tracker import open_tracker
from studies.tuning.claim import is_dead
from studies.tuning.study_spec import StudySpec, TuneEvent
from studies.tuning.trial_store import open_trials
from studies.tuning.trial_worker import run_study
from studies.tuning.tune import tune

if TYPE_CHECKING:
    from postgres_for_tests import PostgresServer

MakeSpec = Callable[..., StudySpec]
N_WORKERS = 3
N_KILLS = 20
N_TRIALS = 60
PATIENCE_S = 120.0
# What a worker has loaded by its second trial.
WARM = ["studies.tuning.trial_worker"]


@contextmanager
def workers(spec: StudySpec, paths: ProjectPaths, n_trials: int) -> Iterator[Callable[[], None]]:
    """Keep three workers of their own going; yields what replaces the dead ones."""
    # Forked from a process that has imported everything, a worker costs milliseconds.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(WARM)
    started: list[BaseProcess] = []

    def fill() -> None:
        alive = [process for process in started if process.is_alive()]
        for _ in range(N_WORKERS - len(alive)):
            process = context.Process(target=work, args=(spec, paths, n_trials))
            process.start()
            started.append(process)

    fill()
    try:
        yield fill
    finally:
        for process in started:
            process.kill()
            process.join()


def test_every_trial_ends_once_though_workers_are_killed_at_twenty_moments(
    make_spec: MakeSpec, tmp_path: Path, storage: str
) -> None:
    # Declared settings: what the search proposes with several workers is another test's.
    enqueue = tuple({"beta": 1.0 + step} for step in range(N_TRIALS))
    spec = make_spec(n_parallel=N_WORKERS, enqueue=enqueue)
    paths = ProjectPaths(tmp_path, storage)
    store = open_trials(paths, spec)
    chance = random.Random(4)
    moments = sorted(chance.sample(range(N_TRIALS - 1), N_KILLS))
    deadline = time.monotonic() + PATIENCE_S
    n_kills = 0
    with workers(spec, paths, N_TRIALS) as fill:
        while len(store.finished()) < N_TRIALS:
            assert time.monotonic() < deadline
            fill()
            if n_kills < N_KILLS and len(store.finished()) >= moments[n_kills]:
                time.sleep(chance.uniform(0.0, 0.1))
                victims = [trial.owner for trial in store.running() if not is_dead(trial.owner, 0.0)]
                if victims:
                    os.kill(chance.choice(victims)["pid"], signal.SIGKILL)
                    n_kills += 1
            time.sleep(0.005)
    assert n_kills == N_KILLS
    assert store.claims() == []

    records = store.records()
    assert [record.index for record in records] == list(range(N_TRIALS))
    assert {record.state for record in records} == {"complete", "pruned"}
    assert 0 < sum(record.attempts - 1 for record in records) <= N_KILLS
    alone = ProjectPaths(tmp_path / "alone")
    run_study(spec, paths=alone, n_trials=N_TRIALS, emit=ignore)
    assert essence(records) == essence(records_of(spec, alone))

    tune([spec], paths=paths, n_trials=N_TRIALS, n_jobs=1, tracker=open_tracker(paths))
    known = {record.index: record for record in records}
    states = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED}
    in_store = in_optuna(spec, paths)
    assert {t.user_attrs["index"]: (t.state, t.params) for t in in_store} == {
        index: (states[record.state], record.params) for index, record in known.items()
    }
    assert len(in_store) == N_TRIALS
    client = MlflowClient(paths.tracking_uri)
    (experiment,) = (found for found in client.search_experiments() if found.name == spec.label)
    runs = client.search_runs([experiment.experiment_id], "tags.role = 'trial'", max_results=1000)
    ends = {"complete": "FINISHED", "pruned": "KILLED"}
    assert sorted((run.data.tags["trial_key"], run.info.status) for run in runs) == sorted(
        (record.key, ends[record.state]) for record in records
    )


def test_a_server_that_is_away_for_a_while_is_waited_for(
    make_spec: MakeSpec,
    tmp_path: Path,
    storage: str,
    postgres_server: "PostgresServer",
    caplog: pytest.LogCaptureFixture,
) -> None:
    spec = make_spec(n_parallel=2)
    paths = ProjectPaths(tmp_path, storage)

    is_stopped = False

    def stop(event: TuneEvent) -> None:
        nonlocal is_stopped
        if event.kind == "trial-started" and event.index == 2 and not is_stopped:
            is_stopped = True
            postgres_server.stop()

    class Repair(logging.Handler):
        """Starts the server again once somebody says that it is away."""

        def emit(self, record: logging.LogRecord) -> None:
            if record.getMessage().startswith("waiting: "):
                postgres_server.start()

    repair = Repair()
    logging.getLogger("studies.tuning.tune").addHandler(repair)
    try:
        (summary,) = tune([spec], paths=paths, n_trials=6, n_jobs=2, on_event=stop)
    finally:
        logging.getLogger("studies.tuning.tune").removeHandler(repair)
    assert (summary.n_trials, summary.n_failed) == (6, 0)
    said = [record.message for record in caplog.records if record.name == "studies.tuning.tune"]
    assert [line.split(" ")[0] for line in said] == ["waiting:", "going"]
    assert "does not answer" in said[0]
    assert [record.attempts for record in records_of(spec, paths)] == [1] * 6
    alone = ProjectPaths(tmp_path / "alone")
    run_study(spec, paths=alone, n_trials=6, emit=ignore)
    assert essence(records_of(spec, paths)) == essence(records_of(spec, alone))
    assert sorted(t.user_attrs["index"] for t in in_optuna(spec, paths)) == list(range(6))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("tester@", "guarded:wrong@"), "refuses .*password authentication failed.* correct the user or"),
        (("/studies", "/nowhere"), 'database "nowhere.*" does not exist.*; create it, or correct the URL'),
        (("port", "1"), "does not answer .*; start the server or correct the URL"),
        (("127.0.0.1", "no.such.host.invalid"), "correct the host of the URL"),
    ],
    ids=["password", "database", "port", "host"],
)
def test_a_storage_that_cannot_be_used_is_one_line(
    storage: str,
    postgres_server: "PostgresServer",
    tmp_path: Path,
    change: tuple[str, str],
    message: str,
    make_spec: MakeSpec,
) -> None:
    if change[1].startswith("guarded"):
        postgres_server.execute("drop role if exists guarded")
        postgres_server.execute("create role guarded login password 'secret'")
    given = (
        storage.replace(*change) if change[0] != "port" else storage.replace(str(postgres_server.port), "1")
    )
    paths = ProjectPaths(tmp_path, given)
    with pytest.raises(InputError, match=message) as caught:
        open_trials(paths, make_spec()).records()
    assert "\n" not in str(caught.value)
    assert "wrong" not in str(caught.value)


def test_a_role_that_may_not_make_schemas_is_one_line(
    storage: str, postgres_server: "PostgresServer", tmp_path: Path, make_spec: MakeSpec
) -> None:
    postgres_server.execute("drop role if exists guarded")
    postgres_server.execute("create role guarded login password 'secret'")
    paths = ProjectPaths(tmp_path, storage.replace("tester@", "guarded:secret@"))
    with pytest.raises(
        InputError, match=r"permission denied for database .*; let the server's admin"
    ) as caught:
        open_trials(paths, make_spec()).records()
    assert "secret" not in str(caught.value)


def test_another_version_of_our_schema_is_one_line(
    storage: str, postgres_server: "PostgresServer", tmp_path: Path, make_spec: MakeSpec
) -> None:
    open_trials(ProjectPaths(tmp_path, storage), make_spec()).records()
    postgres_server.execute("update studies.schema_version set version = 99", storage.rsplit("/", 1)[1])
    with pytest.raises(InputError, match="has version 99 of our schema, this program knows 1; use"):
        open_trials(ProjectPaths(tmp_path, f"{storage}?sslmode=disable"), make_spec()).records()
