"""What a trial of 200 epochs with 4 curves costs beside its training: Optuna, MLflow and the weights.

Two workers on two studies side by side, on SQLite and on PostgreSQL. The cost of a trial is the time from its
begin to that of the next one, less the time that this very trial trained: the time inside the training, less
that inside the functions it calls for Optuna and MLflow. Prints and gates nothing; the goal is 0.3 s. Type:

    python tests/benchmarks/trial_overhead.py
"""

import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS.parent), str(TESTS), str(TESTS / "tuning")]
N_TRIALS, N_EPOCHS, GOAL_S = 15, 200, 0.3
SIZES = (16, 24)


def main() -> None:
    """Measure both storages and print medians."""
    from mlflow_store_for_tests import give_store
    from postgres_for_tests import PostgresServer, missing_postgres
    from toy_study_for_tests import add_sets, toy_study

    from studies.paths import ProjectPaths
    from studies.tuning.declaration import Declaration

    def spec(n_train: int) -> Declaration:
        settings = toy_study().settings | {"max_epochs": N_EPOCHS, "patience": N_EPOCHS}
        # One configuration again and again, so that each trial trains for the same time.
        return toy_study(n_train, settings=settings, search={})

    server = None if missing_postgres() else PostgresServer()
    try:
        for name in ("SQLite", "PostgreSQL"):
            if name == "PostgreSQL" and server is None:
                print(f"PostgreSQL: {missing_postgres()}")
                continue
            with tempfile.TemporaryDirectory() as folder:
                root = Path(folder)
                add_sets(root)
                give_store(root)
                url = server.new_database() if server and name == "PostgreSQL" else None
                _measure(name, [spec(n) for n in SIZES], ProjectPaths(root, url))
    finally:
        if server is not None:
            server.close()


def _measure(name: str, specs: list, paths) -> None:  # type: ignore[no-untyped-def, type-arg]
    from toy_study_for_tests import plain_study

    from studies.tuning.tune_studies import THREADS, tune

    tune(specs, paths=paths, n_trials=N_TRIALS, n_jobs=1, until_s=0.0)
    workers = [
        subprocess.Popen(
            [sys.executable, __file__, str(paths.root), paths.storage or "", spec.name],
            stdout=subprocess.PIPE,
            env=THREADS,
            text=True,
        )
        for spec in specs
    ]
    for spec, worker in zip(specs, workers, strict=True):
        trained = json.loads(worker.communicate()[0])
        trials = plain_study(paths, spec.name).get_trials()
        begins = [trial.datetime_start.timestamp() for trial in trials if trial.datetime_start]
        whole = [later - earlier for earlier, later in pairwise(begins)]
        # The first trials of a process load what the later ones have.
        cost = [one - alone for one, alone in zip(whole, trained, strict=False)][2:]
        print(
            f"{name}, n_train {spec.n_train}: {statistics.median(cost):.2f} s of bookkeeping a trial "
            f"({min(cost):.2f} to {max(cost):.2f} s, goal {GOAL_S:g} s), which trains for "
            f"{statistics.median(trained):.2f} s"
        )


def work(root: str, storage: str, name: str) -> None:
    """Be a worker that says how long each of its trials trained."""
    from studies.paths import ProjectPaths
    from studies.tuning import worker

    trained: list[float] = []
    train = worker.train

    def timed(*given: Any, on_epoch: Callable[..., None], on_report: Callable[..., None]) -> Any:
        inside = 0.0

        def timed_listener(listener: Callable[..., None]) -> Callable[..., None]:
            def timed(*said: Any) -> None:
                nonlocal inside
                began = time.perf_counter()
                listener(*said)
                inside += time.perf_counter() - began

            return timed

        began = time.perf_counter()
        result = train(*given, on_epoch=timed_listener(on_epoch), on_report=timed_listener(on_report))
        trained.append(time.perf_counter() - began - inside)
        return result

    worker.train = timed
    worker.Worker(ProjectPaths(Path(root), storage or None), name).run()
    print(json.dumps(trained))


if __name__ == "__main__":
    work(*sys.argv[1:]) if sys.argv[1:] else main()
