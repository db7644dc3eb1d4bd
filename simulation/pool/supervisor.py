"""A process that supervises one worker after the other; each is forked from it.

It never runs code of an FMU, so nothing keeps it from ending a worker, or from ending with its program.
"""

import contextlib
import os
import pickle
import shutil
import signal
import tempfile
from collections import Counter
from dataclasses import dataclass
from math import inf
from multiprocessing import Pipe
from multiprocessing.connection import Connection, wait
from pathlib import Path
from time import monotonic

import numpy as np
import psutil

from simulation.arrays import FloatArray
from simulation.errors import InputError, MachineError
from simulation.foreign_code import ENDED_BY
from simulation.pool.execution import ExecutionPolicy
from simulation.pool.family import adopt_orphans, children, in_a_fork, kill_descendants
from simulation.pool.worker_process import (
    LOG,
    ChunkAnswer,
    End,
    Factory,
    NewProcess,
    Opened,
    SharedRows,
    prepare,
    refusal,
    remember,
    subject,
    work,
)
from simulation.scratch import ScratchFolder

SCRATCH_PREFIX = "simulation-workers-"
OPENING_S = 60.0
"""Time that a model may take to open, if its time-out is shorter. [s]"""
# A refused licence may come free. [s]
_PAUSES_S = (0.25, 1.0)
# What a worker may take to close its model, and the system to write down what is left of one that crashed.
_CLOSING_S = 1.0
_CRASHING_S = 10.0
# No row kills its process by SIGKILL or between two rows: it was only running when another kill came.
_SPARE_TRIES = 3
_MAX_IN_VAIN = 5  # processes in a row that answer none, each at the FMU's own wish
# Memory is looked at this often; no FMU fills more in this time than it can write. [s]
_LOOK_S = 0.05
# An FMU that prints at every step would fill the disk: its process is replaced.
_MAX_LOG_BYTES = 10_000_000
_MAX_SAID = 300  # characters of its last line that a reason quotes


@dataclass(frozen=True)
class Job:
    """To the fork server, and through it to a new supervisor: what to simulate, and where it runs.

    Attributes:
        make_model: The model's factory, pickled.
        module: The module of the factory.
        known: What workers for this program have compiled before, see learnt().
        policy: What happens to rows that hang, crash or fail.
        folder: Where relative paths begin.
    """

    make_model: bytes
    module: str
    known: frozenset[bytes]
    policy: ExecutionPolicy
    folder: str


def supervise(parent: Connection, job: Job) -> None:
    """Be a supervisor until the far end of a connection closes.

    Args:
        parent: To the process that asks: theta, times and which rows need a new process come, a ChunkAnswer
            goes. Opened goes before the first answer; an exception is the last word.
        job: What to simulate.
    """
    adopt_orphans()
    try:
        with contextlib.closing(_Supervisor(parent, job)) as supervisor:
            supervisor.serve()
    except (EOFError, OSError):
        pass  # the process that asked is gone, or done
    except Exception as error:
        parent.send(error if isinstance(error, RuntimeError) else refusal(error))


def no_process(error: OSError) -> MachineError:
    """Return the error for a process that cannot be started.

    Args:
        error: Why.
    """
    return MachineError(
        f"a process for simulations cannot be started ({error.strerror}); lower simulation.max_workers, or "
        f"free memory, processes or room in {tempfile.gettempdir()}"
    )


@dataclass(eq=False)
class _Worker:
    pid: int
    connection: Connection
    folder: Path
    n_rows: int = 0
    first_mb: float | None = None

    @property
    def mb(self) -> float:
        """Memory that is its own and that of its children; what is shared does not count."""
        taken = 0.0
        for pid in (self.pid, *children(self.pid)):
            with contextlib.suppress(psutil.NoSuchProcess):
                info = psutil.Process(pid).memory_info()
                taken += float(info.rss - info.shared) / 1e6
        return taken


class _Supervisor:
    def __init__(self, parent: Connection, job: Job) -> None:
        os.chdir(job.folder)
        self._parent = parent
        self._make_model: Factory = pickle.loads(job.make_model)
        self._policy = job.policy
        self._rows = SharedRows()
        self._opened: Opened | None = None
        self._worker: _Worker | None = None
        self._n_workers = 0
        self._slowest_s: float | None = None
        self._opening_s = inf
        self._is_busy = True
        self._scratch = ScratchFolder(SCRATCH_PREFIX)
        prepare(self._make_model)

    def serve(self) -> None:
        """Answer; the first time, the model is opened."""
        while True:
            self._is_busy = False
            if self._worker is not None and self._worker.connection in wait(
                [self._parent, self._worker.connection]
            ):
                self._end(self._worker, 0.0)  # it ended by itself
            theta, budget_s, self._slowest_s, new_process = self._parent.recv()
            self._is_busy = True
            if self._opened is None:
                self._open()
                self._parent.send(self._opened)
            self._parent.send(self._simulated(theta, monotonic() + budget_s, new_process))

    def close(self) -> None:
        """End the worker and all that it started, and remove what they wrote."""
        if self._worker is not None:
            self._end(self._worker, 0.0 if self._is_busy else _CLOSING_S)
        self._scratch.remove()

    # Workers

    def _open(self) -> _Worker:
        """Return a worker with an open model."""
        pauses_s = iter(_PAUSES_S)
        while True:
            began = monotonic()
            worker = self._fork()
            answer = self._first_words(worker)
            if isinstance(answer, Opened):
                self._opened = answer
                self._opening_s = min(self._opening_s, monotonic() - began)
                self._rows.map(answer.facts)
                return worker
            if (pause_s := next(pauses_s, None)) is None:
                raise answer
            if self._parent.poll(pause_s):
                raise EOFError

    def _fork(self) -> _Worker:
        if self._opened is not None:
            remember(self._opened.known)
        folder = self._scratch.folder / f"{self._n_workers:05d}"
        self._n_workers += 1

        def work_alone() -> None:
            near.close()
            self._parent.close()
            work(far, self._make_model, folder, self._rows, self._policy.finite_timeout_s)

        try:
            folder.mkdir()
            near, far = Pipe()
            with far:
                self._worker = _Worker(in_a_fork(work_alone), near, folder)
        except OSError as error:
            raise no_process(error) from None
        return self._worker

    def _first_words(self, worker: _Worker) -> Opened | Exception:
        what, timeout_s = subject(self._make_model), self._policy.finite_timeout_s
        limit_s = None if timeout_s is None else max(timeout_s, OPENING_S)
        if has_hung := not self._has_spoken(worker, limit_s):
            os.kill(worker.pid, signal.SIGKILL)
        try:
            answer: Opened | Exception = worker.connection.recv()
        except (EOFError, OSError):
            exit_code, how = self._end(worker, _CRASHING_S)
            if exit_code == -ENDED_BY:
                has_hung, limit_s = True, timeout_s
            if has_hung:
                # A model that hung will hang again; it is not waited for twice.
                raise InputError(
                    f"{what}: did not open within {limit_s:g} s and was stopped; raise simulation.timeout_s"
                ) from None
            return InputError(f"{what}: opening it {how}; try it in another FMI tool")
        if not isinstance(answer, Opened):
            self._end(worker, _CLOSING_S)
        return answer

    def _has_spoken(self, worker: _Worker, patience_s: float | None) -> bool:
        """Wait until a worker answers or ends, as long as the process that asks is there."""
        ready = wait([self._parent, worker.connection], patience_s)
        if self._parent in ready:
            raise EOFError  # a message while a row runs can only be the end of the connection
        return bool(ready)

    def _end(self, worker: _Worker, patience_s: float) -> tuple[int, str]:
        """See a worker off with all that it started; return its exit code, and how it ended, for a reason."""
        self._worker = None
        worker.connection.close()
        process = os.pidfd_open(worker.pid)
        wait([process], patience_s)
        os.close(process)
        os.kill(worker.pid, signal.SIGKILL)
        exit_code = os.waitstatus_to_exitcode(os.waitpid(worker.pid, 0)[1])
        kill_descendants()
        how = f"ended its process with exit code {exit_code}"
        if exit_code < 0:
            with contextlib.suppress(ValueError):
                how = f"crashed its process ({signal.Signals(-exit_code).name})"
        if exit_code == -signal.SIGKILL:
            how = "was killed (SIGKILL), perhaps for want of memory"
        with contextlib.suppress(OSError):
            log = (worker.folder / LOG).read_text(encoding="utf-8", errors="replace")
            if said := " ".join(log.rstrip().rpartition("\n")[-1].split())[:_MAX_SAID]:
                how = f"{how}; last message: {said}"
        shutil.rmtree(worker.folder, ignore_errors=True)
        return exit_code, how

    # Rows

    def _simulated(self, theta: FloatArray, deadline: float, new_process: NewProcess) -> ChunkAnswer:
        """Simulate rows until all are finished or the time is up."""
        n, policy = len(theta), self._policy
        y, failures = np.full((n, *self._rows.y.shape[1:]), np.nan), [""] * n
        is_first = np.zeros(n, dtype=np.bool_)
        row, n_done, spent_s = 0, 0, 0.0
        tries: Counter[End] = Counter()
        is_alone = new_process is NewProcess.EACH_ROW
        if new_process is not NewProcess.WHEN_NEEDED and self._worker is not None and self._worker.n_rows:
            self._end(self._worker, _CLOSING_S)
        while row < n and (row == 0 or tries or monotonic() < deadline):
            worker = self._worker or self._open()
            part = theta[row : row + (1 if is_alone else self._rows.capacity)]
            failures[row : row + len(part)] = [""] * len(part)
            end = self._run(worker, part, min(deadline, monotonic() + _LOOK_S), failures, row)
            done = int(self._rows.done[0])
            was_between = self._rows.begun[0] == done
            y[row : row + done] = self._rows.y[:done]
            is_first[row : row + done][:1] = worker.n_rows == 0
            row, n_done, spent_s = row + done, n_done + done, spent_s + self._rows.spent[0]
            worker.n_rows += done
            if done:
                tries.clear()
            if end in (End.DONE, End.LEAVES):
                if is_alone or end is End.LEAVES or self._is_worn_out(worker):
                    self._end(worker, _CLOSING_S)
                # One that has answered rows has done its part.
                if worker.n_rows:
                    continue
                how, allowed = "asked for another process", _MAX_IN_VAIN - 1
            elif end is End.HUNG:
                self._end(worker, 0.0)
                how = policy.why_stopped(self._slowest_s)
                allowed = _SPARE_TRIES * was_between
            else:
                exit_code, how = self._end(worker, _CRASHING_S)
                how, was_killed = f"the FMU {how}", was_between or exit_code == -signal.SIGKILL
                allowed = policy.retries + _SPARE_TRIES * was_killed
            tries[end] += 1
            if tries[end] > allowed:
                failures[row] = (f"{tries[end]} times: " if tries[end] > 1 else "") + how
                row += 1
                tries.clear()
        row_s = spent_s / n_done if n_done else None
        return ChunkAnswer(y[:row], tuple(failures[:row]), row_s, is_first[:row], self._opening_s)

    def _is_worn_out(self, worker: _Worker) -> bool:
        if worker.first_mb is None:
            worker.first_mb = worker.mb
        return (
            worker.mb - worker.first_mb > self._policy.max_growth_mb
            or (worker.folder / LOG).stat().st_size > _MAX_LOG_BYTES
        )

    def _run(
        self, worker: _Worker, theta: FloatArray, deadline: float, failures: list[str], first: int
    ) -> End:
        """Have rows simulated, the first of which is that of a number, and note why they failed."""
        rows, limit_s = self._rows, self._policy.limit_s(self._slowest_s)
        rows.begun[0] = rows.done[0] = rows.spent[0] = 0.0
        rows.started[0] = monotonic()
        how = End.DIED
        try:
            worker.connection.send((theta, deadline))
            while True:
                now = monotonic()
                left_s = max(0.0, rows.started[0] + limit_s - now) if how is End.DIED else inf
                if not self._has_spoken(worker, None if left_s == inf else left_s):
                    if left_s:
                        continue
                    os.kill(worker.pid, signal.SIGKILL)
                    os.waitid(os.P_PID, worker.pid, os.WEXITED | os.WNOWAIT)
                    # It may have come to the next row at this very moment.
                    how = End.HUNG if rows.started[0] + limit_s <= now else End.LEAVES
                    continue
                message = worker.connection.recv()
                if isinstance(message, End):
                    return message
                row, reason = message
                failures[first + row] = reason
        except (EOFError, OSError):
            if self._parent.poll():
                raise EOFError from None
            return how
