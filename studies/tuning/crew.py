"""Worker processes that train trials: hired, listened to, replaced when they die, dismissed in order."""

import multiprocessing
import os
import signal
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from multiprocessing.synchronize import Event

from simulation.errors import InputError, MachineError
from simulation.workers.held_interrupts import ignore_interrupts, interrupts_masked
from simulation.workers.memory_watch import OutOfMemoryWatch
from simulation.workers.parallel import exit_with_parent
from studies.environment import explain
from studies.paths import ProjectPaths
from studies.storage_url import hide_passwords
from studies.tuning.outage import StudyInterruptedError, wait_out
from studies.tuning.slots import reap
from studies.tuning.study_spec import StudySpec, TuneEvent
from studies.tuning.trial_store import open_trials

GRACE_S = 3.0  # a worker looks at the stop sign at every validated epoch
MAX_IDLE_DEATHS = 3  # workers in a row that die before they begin a trial; another would hardly do better
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


class TuningError(RuntimeError):
    """A worker failed for a reason that is not a trial's."""


@dataclass(frozen=True)
class _Failure:
    """What a worker says when it cannot go on."""

    line: str
    kind: type[Exception]


@dataclass(frozen=True)
class _Done:
    """What a worker says when it has found no more to do."""


@dataclass
class _Worker:
    process: SpawnProcess
    connection: Connection
    has_begun: bool = False


class Crew:
    """Processes that train the trials of several studies, side by side with those of other commands.

    Args:
        paths: the project.
        n_trials: finished trials per study in total.
        n_workers: processes; where studies have places for fewer, each trains on several threads.
        deadline_s: no trial begins after this moment. [s since 1970, UTC]
        tell: told what is waited for, and an empty line when it is there again.
    """

    def __init__(
        self,
        *,
        paths: ProjectPaths,
        n_trials: int,
        n_workers: int,
        deadline_s: float | None = None,
        tell: Callable[[str], None] = lambda line: None,
    ) -> None:
        self._paths = paths
        self._n_trials = n_trials
        self._n_workers = n_workers
        self._deadline_s = deadline_s
        self._tell = tell
        self._context = multiprocessing.get_context("spawn")
        self._stop: Event = self._context.Event()
        self._workers: list[_Worker] = []
        self._leaving: list[SpawnProcess] = []
        self._studies: list[StudySpec] = []
        self._n_jobs = 1
        self._n_idle_deaths = 0
        self._memory = OutOfMemoryWatch()

    @property
    def pids(self) -> list[int]:
        """Process ids of the workers."""
        return [worker.process.pid for worker in self._workers if worker.process.pid is not None]

    def run(self, studies: Sequence[StudySpec]) -> Iterator[tuple[StudySpec, TuneEvent]]:
        """Run studies and yield what happens, in the order it happens.

        Args:
            studies: the studies, in the order they shall begin.

        Raises:
            InputError: a study cannot be run as declared.
            TuningError: a worker failed for a reason that is not a trial's.
        """
        self._studies = list(studies)
        by_name = {spec.name: spec for spec in studies}
        finished: set[str] = set()
        n_places = sum(min(spec.n_parallel, self._n_trials) for spec in studies)
        n_hired = min(self._n_workers, n_places)
        self._n_jobs = self._n_workers // max(1, n_hired)
        for _ in range(n_hired):
            self._hire()
        while self._workers:
            heard = wait([worker.connection for worker in self._workers])
            for worker in [worker for worker in self._workers if worker.connection in heard]:
                try:
                    message = worker.connection.recv()
                except (EOFError, OSError):
                    self._replace(worker)
                    continue
                if isinstance(message, _Failure):
                    raise message.kind(message.line)
                if isinstance(message, _Done):
                    self._workers.remove(worker)
                    self._leaving.append(worker.process)
                    continue
                worker.has_begun |= message.kind == "trial-started"
                if message.kind == "study-finished":
                    if message.study in finished:
                        continue  # every worker finds out by itself
                    finished.add(message.study)
                yield by_name[message.study], message
        for process in self._leaving:
            process.join()

    def dismiss(self) -> None:
        """Stop all workers soon, and leave no trial with an owner that is gone."""
        self._stop.set()
        deadline = time.monotonic() + GRACE_S
        for worker in self._workers:
            worker.connection.close()
        for worker in self._workers:
            worker.process.join(max(0.0, deadline - time.monotonic()))
            if worker.process.is_alive():
                worker.process.kill()
                worker.process.join()
        stopped = self.pids
        self._workers = []
        # A store that cannot be reached is not why we are here: whoever comes next finds the owners dead.
        with suppress(InputError, OSError):
            self._reap(stopped=stopped)

    def _hire(self) -> None:
        ours, theirs = self._context.Pipe()
        arguments = (
            theirs, self._paths, self._n_trials, self._stop, self._deadline_s, os.getpid(), self._n_jobs
        )  # fmt: skip
        process = self._context.Process(target=_work, args=arguments, name=f"tune-{len(self._workers)}")
        with interrupts_masked(), _one_thread():
            process.start()
            theirs.close()
            ours.send(self._studies)
            self._workers.append(_Worker(process, ours))

    def _replace(self, dead: _Worker) -> None:
        dead.process.join(GRACE_S)
        self._workers.remove(dead)
        crash = f"exit code {dead.process.exitcode}"
        if dead.process.exitcode == -signal.SIGKILL and self._memory.has_struck():
            crash = "out of memory: the system killed it"
        wait_out(lambda: self._reap(crashed={dead.process.pid or 0: crash}), tell=self._tell)
        self._n_idle_deaths = 0 if dead.has_begun else self._n_idle_deaths + 1
        if self._n_idle_deaths == MAX_IDLE_DEATHS:
            raise TuningError(
                f"a worker's process ended {MAX_IDLE_DEATHS} times in a row before a trial began ({crash}); "
                'out of memory, or a script without `if __name__ == "__main__"`?'
            )
        self._hire()

    def _reap(self, *, crashed: Mapping[int, str] | None = None, stopped: Sequence[int] = ()) -> None:
        for spec in self._studies:
            store = open_trials(self._paths, spec)
            with store.lock():
                reap(spec, store, crashed=crashed, stopped=stopped)


def _work(
    connection: Connection,
    paths: ProjectPaths,
    n_trials: int,
    stop: Event,
    deadline_s: float | None,
    command_pid: int,
    n_jobs: int,
) -> None:
    """Train trials in a worker process until there is nothing left to begin."""
    ignore_interrupts()
    exit_with_parent()
    from studies.tuning.trial_worker import Worker

    def emit(event: TuneEvent) -> None:
        try:
            connection.send(event)
        except OSError:  # the parent has hung up; without this the trial would look like a failed one
            raise StudyInterruptedError from None

    specs = _received(connection)
    if specs is None:
        return
    try:
        Worker(
            specs,
            paths=paths,
            n_trials=n_trials,
            emit=emit,
            should_stop=stop.is_set,
            deadline_s=deadline_s,
            command_pid=command_pid,
            n_jobs=n_jobs,
        ).run()
        connection.send(_Done())
    except StudyInterruptedError:
        return
    except InputError as error:
        connection.send(_Failure(str(error), MachineError if isinstance(error, MachineError) else InputError))
    except Exception as error:
        where = explain(error) or "".join(traceback.format_exception(error))
        connection.send(_Failure(hide_passwords(where), TuningError))


def _received(connection: Connection) -> list[StudySpec] | None:
    try:
        specs: list[StudySpec] = connection.recv()
    except (EOFError, OSError):  # the parent has hung up
        return None
    return specs


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
