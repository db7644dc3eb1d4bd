"""Processes of their own, forked from one that has imported everything: their start would take seconds."""

import multiprocessing
import os
import signal
import sys
from multiprocessing.queues import SimpleQueue
from typing import Any

from sqlalchemy import Engine, event

from studies.paths import ProjectPaths
from studies.results.declaration import Declaration
from studies.tracking.runs import RunStore
from studies.tuning.forked_worker import PRELOADED
from studies.tuning.storage import open_storage
from studies.tuning.tune_studies import tune
from studies.tuning.worker import Worker

FORKED = multiprocessing.get_context("forkserver")
FORKED.set_forkserver_preload(["__main__", *PRELOADED, "studies.tuning.tune_studies"])


def run_worker(paths: ProjectPaths, name: str) -> None:
    """Be a worker."""
    Worker(paths, name).run()


def imports_of_worker(paths: ProjectPaths, name: str, answer: "SimpleQueue[list[str]]") -> None:
    """Answer with the modules that a worker imports itself."""
    before = {*sys.modules}
    Worker(paths, name).run()
    answer.put(sorted({*sys.modules} - before))


def make_stores(paths: ProjectPaths, answer: "SimpleQueue[str]") -> None:
    """Make both stores of a project and answer with an experiment's id."""
    open_storage(paths)
    answer.put(RunStore(paths).experiment("toy"))


def run_command(paths: ProjectPaths, spec: Declaration, n_trials: int) -> None:
    """Tune as `studies tune` does."""
    tune([spec], paths=paths, n_trials=n_trials, n_jobs=1)


def is_killed(paths: ProjectPaths, name: str, n_writes: int) -> bool:
    """Run a worker until it is killed right before one of its writes; say whether it came that far."""
    process = FORKED.Process(target=_work_until, args=(paths, name, n_writes))
    process.start()
    process.join()
    return process.exitcode == -signal.SIGKILL


def _work_until(paths: ProjectPaths, name: str, n_writes: int) -> None:
    worker, count = Worker(paths, name), 0

    def write(connection: Any) -> None:
        nonlocal count
        count += str(connection.engine.url.database).endswith("optuna.db")
        if count > n_writes:
            os.kill(os.getpid(), signal.SIGKILL)

    event.listen(Engine, "commit", write)
    worker.run()
