"""Processes that each open the model once and take one start of a row after the other."""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event
from pathlib import Path

from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray
from simulation.fmi.fmu import FmuModel
from simulation.fmi.runner import NeedsFreshProcess
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from simulation.pool.factory import Factory
from simulation.pool.family import end_with_parent
from simulation.pool.pool_model import PoolModel
from studies.paper.direct_journal import Journal
from studies.paper.direct_kept import KeptStarts
from studies.paper.direct_optimizers import StartResult, StartStoppedError, minimize_from
from studies.paper.direct_row import DirectRow
from studies.paper.interrupts import ignore_interrupts, interrupts_masked
from studies.stages.pipeline import StageError

TELL_EVERY = 50
"""Calls after which a worker tells of itself and looks at the stop sign."""

LISTEN_S = 0.3
"""How long progress may be silent. [s]"""


@dataclass(frozen=True)
class DirectProgress:
    """How far a row is.

    Attributes:
        n_done: Starts finished, in this run or before.
        n_starts: Starts in all.
        n_calls: Rows asked of the model in this run.
        best_mse: Best MSE so far. [first output's unit squared]
    """

    n_done: int
    n_starts: int
    n_calls: int
    best_mse: float


OnDirectProgress = Callable[[DirectProgress], None]


@dataclass(frozen=True)
class Task:
    """What worker processes need; plain data.

    Attributes:
        make_model: Factory of the model.
        measurement: What it is compared with.
        row: The row.
        journal: Where a single long start keeps its answers; None for no journal.
    """

    make_model: Factory
    measurement: Measurement
    row: DirectRow
    journal: Path | None


class Crew:
    """Worker processes, each with a model of its own, that take one start after the other."""

    def __init__(
        self,
        task: Task,
        n_workers: int,
        kept: KeptStarts,
        n_starts: int,
        on_progress: OnDirectProgress | None,
    ) -> None:
        """Start nothing yet.

        Args:
            task: What is done.
            n_workers: Most processes.
            kept: Where finished starts go.
            n_starts: Starts of the row in all.
            on_progress: Told how far the row is.
        """
        self._task = task
        self._n_workers = n_workers
        self._kept = kept
        self._n_starts = n_starts
        self._on_progress = on_progress
        context = multiprocessing.get_context("spawn")
        self._context = context
        self._stop: Event = context.Event()
        self._n_calls: Synchronized[int] = context.Value("q", 0)
        self._best: Synchronized[float] = context.Value("d", kept.best_mse)

    def run(self, numbers: Sequence[int], theta0: FloatArray) -> None:
        """Do the starts of these numbers."""
        pool = ProcessPoolExecutor(
            min(self._n_workers, len(numbers)),
            self._context,
            _begin,
            (self._task, self._stop, self._n_calls, self._best),
        )
        futures: dict[Future[StartResult], int] = {}
        try:
            with interrupts_masked():
                futures = {pool.submit(_work, theta0[j]): j for j in numbers}
            waiting = set(futures)
            while waiting:
                done, waiting = wait(waiting, timeout=LISTEN_S, return_when=FIRST_COMPLETED)
                for future in done:
                    self._kept.add(futures[future], future.result())
                self._tell()
        except BrokenProcessPool:
            raise StageError(
                f"{self._task.row.name}: a process of this row ended by itself: the model crashed it, or the "
                "memory is full; finished starts are kept"
            ) from None
        finally:
            self._stop.set()
            pool.shutdown(wait=True, cancel_futures=True)

    def _tell(self) -> None:
        if self._on_progress is not None:
            n_done = sum(j < self._n_starts for j in self._kept.starts)
            self._on_progress(DirectProgress(n_done, self._n_starts, self._n_calls.value, self._best.value))


class _Worker:
    """What a worker process holds."""

    def __init__(
        self, task: Task, stop: Event, n_calls: "Synchronized[int]", best: "Synchronized[float]"
    ) -> None:
        self.task = task
        self._stop = stop
        self._n_calls = n_calls
        self._best = best
        self._untold = 0
        self._model: ForwardModel = task.make_model()
        threadpool_limits(1)

    def minimize(self, theta0: FloatArray) -> StartResult:
        """Do one start; where the model asks for a fresh process, in one that supervises it."""
        try:
            return self._minimize(theta0)
        except NeedsFreshProcess:
            if isinstance(self._model, FmuModel):
                self._model.close()
            self._model = PoolModel(self.task.make_model, 1)
            return self._minimize(theta0)

    def _minimize(self, theta0: FloatArray) -> StartResult:
        task = self.task
        if task.journal is None:
            return minimize_from(self._model, task.measurement, task.row, theta0, on_call=self._hear)
        with Journal(task.journal) as journal:
            return minimize_from(
                self._model, task.measurement, task.row, theta0, journal=journal, on_call=self._hear
            )

    def _hear(self, best_mse: float) -> None:
        self._untold += 1
        if self._untold < TELL_EVERY:
            return
        with self._n_calls.get_lock():
            self._n_calls.value += self._untold
        with self._best.get_lock():
            self._best.value = min(self._best.value, best_mse)
        self._untold = 0
        if self._stop.is_set():
            raise StartStoppedError


_worker: _Worker | None = None


def _begin(task: Task, stop: Event, n_calls: "Synchronized[int]", best: "Synchronized[float]") -> None:
    """Open the model in a new worker process."""
    global _worker
    ignore_interrupts()
    end_with_parent()
    _worker = _Worker(task, stop, n_calls, best)


def _work(theta0: FloatArray) -> StartResult:
    assert _worker is not None, "the pool opens the model first"
    return _worker.minimize(theta0)
