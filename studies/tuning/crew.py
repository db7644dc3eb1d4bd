"""Worker processes that run studies: hired, listened to, replaced when they die, dismissed in order."""

import multiprocessing
import os
import signal
import time
import traceback
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.synchronize import Event
from pathlib import Path

from simulation.errors import InputError
from simulation.file_lock import FileLock
from simulation.workers.parallel import exit_with_parent
from studies.environment import explain
from studies.tuning.study_spec import StudySpec, TuneEvent

GRACE_S = 3.0  # a worker looks at the stop sign at every validated epoch
MAX_IDLE_DEATHS = 3  # workers in a row that die before they begin a trial; another would hardly do better
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class TuningError(RuntimeError):
    """A worker failed for a reason that is not a trial's."""


@dataclass(frozen=True)
class _Failure:
    """What a worker says when it cannot go on."""

    line: str
    is_input_error: bool


@dataclass
class _Worker:
    process: SpawnProcess
    connection: Connection
    spec: StudySpec
    has_begun: bool = False


class Crew:
    """Processes that each run one study at a time.

    Args:
        mlruns: folder of Optuna's journal and of the trials' records.
        n_trials: finished trials per study in total.
        n_workers: processes.
    """

    def __init__(self, *, mlruns: Path, n_trials: int, n_workers: int) -> None:
        self._mlruns = mlruns
        self._n_trials = n_trials
        self._n_workers = n_workers
        self._context = multiprocessing.get_context("spawn")
        self._stop: Event = self._context.Event()
        self._workers: list[_Worker] = []
        self._waiting: deque[StudySpec] = deque()
        self._n_idle_deaths = 0

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers."""
        return [worker.process.pid for worker in self._workers if worker.process.pid is not None]

    def run(self, studies: Sequence[StudySpec]) -> Iterator[tuple[StudySpec, TuneEvent]]:
        """Run studies and yield what happens, in the order it happens.

        Args:
            studies: the studies, in the order they shall begin.

        Raises:
            InputError: a study cannot be run as declared, or another process is running it.
            TuningError: a worker failed for a reason that is not a trial's.
        """
        self._waiting = deque(studies)
        while self._waiting and len(self._workers) < self._n_workers:
            self._hire(self._waiting.popleft())
        while self._workers:
            heard = wait([worker.connection for worker in self._workers])
            for worker in [worker for worker in self._workers if worker.connection in heard]:
                try:
                    message = worker.connection.recv()
                except (EOFError, OSError):
                    self._replace(worker)
                    continue
                if isinstance(message, _Failure):
                    raise InputError(message.line) if message.is_input_error else TuningError(message.line)
                spec = worker.spec
                worker.has_begun |= message.kind == "trial-started"
                if message.kind == "study-finished":
                    self._assign(worker)
                yield spec, message

    def dismiss(self) -> None:
        """Stop all workers soon, and leave no trial running in Optuna's store."""
        self._stop.set()
        deadline = time.monotonic() + GRACE_S
        for worker in self._workers:
            worker.connection.close()
        for worker in self._workers:
            worker.process.join(max(0.0, deadline - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
        # Only now: a store that cannot be read must leave no worker behind, and is not why we are here.
        gone, self._workers = self._workers, []
        for worker in gone:
            with suppress(InputError, OSError):
                self._reap(worker.spec)

    def _hire(self, spec: StudySpec) -> None:
        ours, theirs = self._context.Pipe()
        arguments = (theirs, self._mlruns, self._n_trials, self._stop)
        process = self._context.Process(target=_work, args=arguments, name=f"tune-n{spec.n_train}")
        with _one_thread():
            process.start()
        theirs.close()
        ours.send(spec)
        self._workers.append(_Worker(process, ours, spec))

    def _assign(self, worker: _Worker) -> None:
        """Give a worker its next study, or send it home."""
        if self._waiting:
            worker.spec = self._waiting.popleft()
            worker.connection.send(worker.spec)
        else:
            worker.connection.send(None)
            self._workers.remove(worker)
            worker.process.join(GRACE_S)

    def _replace(self, dead: _Worker) -> None:
        dead.process.join(GRACE_S)
        self._workers.remove(dead)
        crash = f"exit code {dead.process.exitcode}"
        self._reap(dead.spec, crash=crash)
        self._n_idle_deaths = 0 if dead.has_begun else self._n_idle_deaths + 1
        if self._n_idle_deaths == MAX_IDLE_DEATHS:
            raise TuningError(
                f"study {dead.spec.name}: its process ended {MAX_IDLE_DEATHS} times in a row before a trial "
                f'began ({crash}); out of memory, or a script without `if __name__ == "__main__"`?'
            )
        self._hire(dead.spec)

    def _reap(self, spec: StudySpec, crash: str = "") -> None:
        from studies.tuning.study_store import StudyStore

        lock = FileLock(spec.lock_file(self._mlruns))
        if not lock.try_acquire():
            return  # another command works on this study, and mends what it finds
        try:
            StudyStore(spec, self._mlruns).reap(crash=crash)
        finally:
            lock.release()


def _work(connection: Connection, mlruns: Path, n_trials: int, stop: Event) -> None:
    """Run one study after the other in a worker process, until told to go home."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    exit_with_parent()
    from studies.tuning.trial_worker import StudyInterruptedError, run_study

    def emit(event: TuneEvent) -> None:
        try:
            connection.send(event)
        except OSError:  # the parent has hung up; without this the trial would look like a failed one
            raise StudyInterruptedError from None

    while (spec := _next(connection)) is not None:
        try:
            run_study(spec, mlruns=mlruns, n_trials=n_trials, emit=emit, should_stop=stop.is_set)
        except StudyInterruptedError:
            return
        except InputError as error:
            connection.send(_Failure(str(error), is_input_error=True))
        except Exception as error:
            where = explain(error) or "".join(traceback.format_exception(error))
            connection.send(_Failure(f"study {spec.name}: {where}", is_input_error=False))


def _next(connection: Connection) -> StudySpec | None:
    try:
        spec: StudySpec | None = connection.recv()
    except (EOFError, OSError):  # the parent has hung up
        return None
    return spec


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let processes started here compute with one thread: as fast for small networks, the same sums."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
