"""Worker processes of a command, forked from one process that has imported what all need."""

import multiprocessing
import os
import pickle
import signal
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from multiprocessing import forkserver
from pathlib import Path
from types import ModuleType

from simulation.pool.fork_server import ONE_THREAD
from simulation.pool.safe_start import environment_restored, start_safely
from studies.paths import ProjectPaths

# These imports take 8 s of processor time. Optuna and MLflow import the last ones when they open a store.
PRELOADED = (
    "studies.rare_collection",
    "studies.tuning.worker",
    "optuna.storages._rdb.models",
    "mlflow.store.tracking.sqlalchemy_workspace_store",
    "mlflow.store.model_registry.sqlalchemy_workspace_store",
)
_FORKED = multiprocessing.get_context("forkserver")
_FORKED.set_forkserver_preload([*PRELOADED])


class ForkedWorker:
    """A process that runs trials of studies and ends with the one that started it.

    Args:
        paths: the project.
        names: names of the studies.
        until_s: no trial begins after this moment of `time.monotonic`. [s]
        n_threads: folds of a cross-validation that it trains at once.
        objective: what the trials do, pickled by cloudpickle in this command; None where they train
            surrogates.

    Attributes:
        process: the process; it exits with 2 where a study cannot be used.
    """

    def __init__(
        self,
        paths: ProjectPaths,
        names: Sequence[str],
        until_s: float | None,
        n_threads: int,
        objective: bytes | None = None,
    ) -> None:
        # A file and no pipe: a full pipe would stop the worker until it is read.
        self._said = tempfile.NamedTemporaryFile()  # noqa: SIM115 (closed with its worker)
        # An objective finds its modules and files as in this command.
        folder = paths.root if objective is None else Path.cwd()
        from_here = (self._said.name, dict(os.environ), folder, [*sys.path], objective)
        given = (paths, names, until_s, n_threads, *from_here)
        self.process = _FORKED.Process(target=_work, args=given, daemon=True)
        with _fork_server():
            self.process.start()

    def last_line(self) -> str:
        """Return the last line of what it printed; it has ended."""
        with self._said as messages:
            messages.seek(0)
            lines = messages.read().decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "no message"

    def join(self) -> None:
        """Wait for its end."""
        self.process.join()
        self._said.close()


@contextmanager
def _fork_server() -> Iterator[None]:
    """Have the process that workers are forked from, and hide a user's script, which they would run again."""
    script = sys.modules["__main__"]
    # Ctrl-C is for the command, which stops its workers; also while these import.
    masked = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        with environment_restored():
            os.environ.update(ONE_THREAD)
            start_safely()
            forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, masked)
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def _work(
    paths: ProjectPaths,
    names: Sequence[str],
    until_s: float | None,
    n_threads: int,
    messages: str,
    environment: dict[str, str],
    folder: Path,
    path: list[str],
    objective: bytes | None,
) -> None:
    """Be a worker: print into a file, and exit with 2 where a study cannot be used."""
    from studies.tuning.worker import run_studies  # imported before the fork, and not in the command itself

    threading.Thread(target=_end_with_command, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    with open(messages, "wb") as file:  # noqa: PTH123 (by the descriptor)
        for stream in (sys.stdout, sys.stderr):
            os.dup2(file.fileno(), stream.fileno())
    given = None
    if objective is not None:
        sys.path[:] = path
        given = pickle.loads(objective)
    sys.exit(run_studies(paths, names, until_s, n_threads, given))


def _end_with_command() -> None:
    """Wait for the end of the command: a killed one cannot end its workers itself."""
    command = multiprocessing.parent_process()
    assert command is not None, "multiprocessing started this process"
    command.join()
    os.kill(os.getpid(), signal.SIGKILL)
