"""Processes that each open the model once and take one start of a row after the other."""

import multiprocessing
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing.synchronize import Event
from pathlib import Path

from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray
from simulation.fmi.fmu import FmuModel
from simulation.fmi.runner import NeedsFreshProcess
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from simulation.workers.held_interrupts import ignore_interrupts, interrupts_masked
from simulation.workers.parallel import ParallelModel, exit_with_parent
from simulation.workers.recipe import Recipe
from studies.paper.direct_journal import Journal
from studies.paper.direct_kept import KeptStarts
from studies.paper.direct_optimizers import StartResult, StartStoppedError, minimize_from
from studies.paper.direct_row import DirectRow
from studies.stages.pipeline import StageError

LOOK_EVERY = 50
"""Calls after which a worker looks at the stop sign."""

OnStart = Callable[[int, int], None]
"""Told how many starts of a row are finished, in this run or before, and how many there are."""


@dataclass(frozen=True)
class Task:
    """What worker processes need; plain data.

    Attributes:
        make_model: Recipe for the model.
        measurement: What it is compared with.
        row: The row.
        journal: Where a single long start keeps its answers; None for no journal.
    """

    make_model: Recipe
    measurement: Measurement
    row: DirectRow
    journal: Path | None


def compute_starts(
    task: Task,
    n_workers: int,
    kept: KeptStarts,
    numbers: Sequence[int],
    theta0: FloatArray,
    on_start: Callable[[], None],
) -> None:
    """Do starts in worker processes, each with a model of its own.

    Args:
        task: What is done.
        n_workers: Most processes.
        kept: Where finished starts go.
        numbers: Which starts.
        theta0: Starting points of the row. Shape (s, p). [per parameter]
        on_start: Called after each finished start.

    Raises:
        StageError: A process ended by itself.
    """
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    pool = ProcessPoolExecutor(min(n_workers, len(numbers)), context, _begin, (task, stop))
    try:
        with interrupts_masked():
            futures = {pool.submit(_work, theta0[j]): j for j in numbers}
        for future in as_completed(futures):
            kept.add(futures[future], future.result())
            on_start()
    except BrokenProcessPool:
        raise StageError(
            f"{task.row.name}: a process of this row ended by itself: the model crashed it, or the "
            "memory is full; finished starts are kept"
        ) from None
    finally:
        stop.set()
        pool.shutdown(wait=True, cancel_futures=True)


class _Worker:
    """What a worker process holds."""

    def __init__(self, task: Task, stop: Event) -> None:
        self.task = task
        self._stop = stop
        self._n_calls = 0
        self._model: ForwardModel = task.make_model()
        threadpool_limits(1)

    def minimize(self, theta0: FloatArray) -> StartResult:
        """Do one start; where the model asks for a fresh process, in one that supervises it."""
        try:
            return self._minimize(theta0)
        except NeedsFreshProcess:
            if isinstance(self._model, FmuModel):
                self._model.close()
            self._model = ParallelModel(self.task.make_model, 1)
            return self._minimize(theta0)

    def _minimize(self, theta0: FloatArray) -> StartResult:
        task = self.task
        if task.journal is None:
            return minimize_from(self._model, task.measurement, task.row, theta0, on_call=self._look)
        with Journal(task.journal) as journal:
            return minimize_from(
                self._model, task.measurement, task.row, theta0, journal=journal, on_call=self._look
            )

    def _look(self, best_mse: float) -> None:
        self._n_calls += 1
        if self._n_calls % LOOK_EVERY == 0 and self._stop.is_set():
            raise StartStoppedError


_worker: _Worker | None = None


def _begin(task: Task, stop: Event) -> None:
    """Open the model in a new worker process."""
    global _worker
    ignore_interrupts()
    exit_with_parent()
    _worker = _Worker(task, stop)


def _work(theta0: FloatArray) -> StartResult:
    assert _worker is not None, "the pool opens the model first"
    return _worker.minimize(theta0)
