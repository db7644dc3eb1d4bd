"""PoolModel: a forward model whose rows are simulated by a pool of processes, here or on a cluster."""

import logging
import os
from collections import Counter
from collections.abc import Callable, Generator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ThreadPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass
from math import inf
from pathlib import Path
from time import monotonic
from typing import NamedTuple, Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.errors import InputError, OutOfTimeError
from simulation.parameters import ParameterSpace
from simulation.pool.chunks import RowQueue
from simulation.pool.execution import ExecutionPolicy
from simulation.pool.processes import Processes, ProcessLostError, RemoteModel
from simulation.pool.worker_process import (
    MAX_CHUNK_BYTES,
    ChunkAnswer,
    Factory,
    Facts,
    NewProcess,
    Question,
    known_facts,
    packed,
)
from simulation.trajectories import Trajectories

_LOG = logging.getLogger(__name__)
# Long enough to hide what it costs to hand out a chunk; to another machine that costs more.
_CHUNK_S = 0.05
_REMOTE_CHUNK_S = 1.0
# A chunk that takes so much longer than expected leaves the rest of its rows to others.
_MAX_OVERRUN = 4.0
# Another process must have this much to do to be worth opening the model once more.
START_PAYS_S = 0.3
# A first row that is still running may be compiling or loading something, but not for this long. [s]
_SURELY_SLOW_S = 2.0
# Answers after which the time per row is known.
_N_SURE = 3
_TICK_S = 0.2  # how often a slow row is looked for
# The warning comes where a chunk takes so many times the usual time of a row, and a minute at least.
_SLOW_FACTOR = 20.0
_SLOW_S = 60.0
# A row that is lost so often with its process may be the reason.
_MAX_LOSSES = 5
# Where a process costs less than this share of a simulation, each simulation gets a new one. [1]
_SMALL_SHARE = 0.1
# So much a batch may lose to new processes without a user who waits for it noticing: it is what checking
# whether rows of one process depend on each other takes, too. [s]
_UNNOTICED_S = 1.0
# And so much a model in all, as one of a search by the thousand: some hundred rows of a quick FMU. [s]
_UNNOTICED_IN_ALL_S = 10.0
# The first opening may have compiled something: it takes two to know what opening costs.
_N_OPENINGS = 2


class Finished(NamedTuple):
    """Rows of a batch that have finished.

    Attributes:
        rows: Their positions in the batch. Shape (m,).
        answer: Their trajectories.
        is_first: Which of them were the first of their process: no row before them can have changed their
            answers. Shape (m,).
    """

    rows: IntArray
    answer: Trajectories
    is_first: BoolArray


@dataclass
class Durations:
    """What simulations have taken so far.

    Attributes:
        opening_s: Least time that a process has taken to start and to open the model. [s]
        n_openings: Rows that had a new process.
        opened_s: What that took in all. [s]
        row_s: Time of a simulation without what opens the model; None where nothing was simulated yet. [s]
        slowest_s: The slowest simulation; None likewise. [s]
        n_answers: Chunks that were answered.
    """

    opening_s: float = inf
    n_openings: int = 0
    opened_s: float = 0.0
    row_s: float | None = None
    slowest_s: float | None = None
    n_answers: int = 0

    def note(self, answer: ChunkAnswer) -> None:
        """Take note of what a chunk took."""
        self.opening_s = min(self.opening_s, answer.opening_s)
        if n := int(answer.is_first.sum()):
            self.n_openings += n
            self.opened_s += n * self.opening_s
        if answer.row_s is not None:
            self.n_answers += 1
            self.slowest_s = max(self.slowest_s or 0.0, answer.row_s)
            # The first row may have loaded something. Other work on the machine only ever adds to a time.
            if self.n_answers > 1:
                self.row_s = min(answer.row_s, 0.5 * ((self.row_s or answer.row_s) + answer.row_s))


class PoolModel:
    """A model whose every row is simulated in a worker process, never in this one.

    A crash, a hang or a leak costs one row. Processes start with the first row, as many as the rows are
    worth. Where a new process costs little, each row gets one, and nothing that an FMU remembers can reach
    it: where it takes less than a tenth of a simulation, and in batches too small for the difference to
    be noticed. Else processes stay until close() and simulate one row after the other; `Finished.is_first`
    says which rows were not the first. Not for use from several threads at once.

    Attributes:
        always_new: Whether each row gets a process of its own, whatever that costs.
        begins_until_s: When to begin no further row, on the monotonic clock; infinite for never. [s]
    """

    def __init__(
        self,
        make_model: Factory,
        n_workers: int | None = None,
        *,
        policy: ExecutionPolicy | None = None,
        executor: Executor | None = None,
        on_warning: Callable[[str], None] | None = None,
    ) -> None:
        """Set up; no process starts before the first row.

        Args:
            make_model: The model's factory, which other processes must be able to import. Where it is the
                bound method of an object that has the model's parameter_space, output_names and time, these
                are known without opening it anywhere.
            n_workers: Most processes that simulate; None for one per core that this process may use, or for
                what the executor has.
            policy: What happens to rows that hang, crash or fail; max_workers limits n_workers.
            executor: Who simulates, each chunk in a supervised process there; it stays the caller's. None for
                processes of this machine.
            on_warning: Called with one line that a user should see at once; None for the log.
        """
        if not callable(make_model):
            raise InputError(
                "processes need a factory of the model, as case.make_model, not a "
                f"{type(make_model).__name__}"
            )
        if n_workers is not None and n_workers < 1:
            raise ValueError(f"n_workers is {n_workers}; at least one process has to work")
        self._policy = policy or ExecutionPolicy()
        self._facts = known_facts(make_model)
        self._make_ready: Callable[[Callable[[str], None]], None] | None = getattr(
            getattr(make_model, "__self__", None), "make_ready", None
        )
        self._n_workers = n_workers
        self._on_warning = on_warning or _LOG.warning
        self._processes = Processes(make_model, self._policy)
        self._threads: ThreadPoolExecutor | None = None
        self._executor = executor
        self._remote: RemoteModel | None = None
        if executor is not None:
            file = getattr(getattr(make_model, "__self__", None), "path", None)
            send_file = getattr(executor, "send_file", None)
            digest = send_file(file) if send_file is not None and isinstance(file, Path) else ""
            self._remote = RemoteModel(packed(make_model), digest, self._policy)
        self.always_new = False
        self.begins_until_s = inf
        self._seen = Durations()
        self._has_warned = False

    @property
    def n_workers(self) -> int:
        """Most processes that rows are spread over."""
        n = self._n_workers or getattr(self._executor, "n_slots", None) or available_cores()
        return min(n, self._policy.max_workers or n)

    @property
    def opening_s(self) -> float:
        """Least time that a process has taken to start and to open the model, infinite for none. [s]."""
        return self._seen.opening_s

    @property
    def simulation_s(self) -> float | None:
        """Time of a simulation without what opens the model, None where nothing was simulated yet. [s]."""
        return self._seen.row_s

    @property
    def n_processes(self) -> int:
        """Worker processes that there are now on this machine."""
        return self._processes.n

    @property
    def _known(self) -> Facts:
        if self._facts is None:
            try:
                facts = self._submit(Question(np.empty((0, 0)), 0.0, None)).result()
            except BaseException:
                self.close()
                raise
            assert isinstance(facts, Facts), "the answer to no rows"
            self._facts = facts
        return self._facts

    @property
    def parameter_space(self) -> ParameterSpace:
        """The model's parameters."""
        return self._known.parameter_space

    @property
    def output_names(self) -> tuple[str, ...]:
        """The model's outputs."""
        return self._known.output_names

    @property
    def time(self) -> FloatArray:
        """The model's output times. Shape (t,). [s]."""
        return self._known.time

    def simulate(self, theta: FloatArray, new_process: NewProcess | None = None) -> Trajectories:
        """Simulate every row.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            new_process: Which rows are the first of their process; None for what this class says.

        Returns:
            The trajectories.

        Raises:
            InputError: If the model cannot be opened, or too many rows fail (TooManyFailuresError).
        """
        theta = self.parameter_space.rows(theta)
        y = np.empty((len(theta), len(self.time), len(self.output_names)))
        failures = np.full(len(theta), "", dtype=object)
        with closing(self.as_finished(theta, new_process)) as chunks:
            for rows, answer, _ in chunks:
                y[rows], failures[rows] = answer.y, answer.failures
        return self._trajectories(theta, y, tuple(failures.tolist()))

    def as_finished(
        self, theta: FloatArray, new_process: NewProcess | None = None, *, until: float = inf
    ) -> Generator[Finished]:
        """Simulate every row and hand over chunks as they finish, in any order.

        Close the generator (contextlib.closing) where not all of it is asked for: that ends what is running.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            new_process: Which rows are the first of their process; None for what this class says. With
                AT_FIRST all rows go to one process, in their order, as long as none of them ends it.
            until: When to end, finished or not, on the monotonic clock. [s]

        Yields:
            Rows that have finished.

        Raises:
            InputError: If the model cannot be opened, or too many rows fail (TooManyFailuresError).
            OutOfTimeError: If rows were not begun before `begins_until_s`.
        """
        theta = self.parameter_space.rows(theta)
        batch = _Batch(self, theta, new_process)
        try:
            while (batch.queue.n_waiting or batch.running) and monotonic() < until:
                if monotonic() < self.begins_until_s:
                    batch.hand_out()
                elif not batch.running:
                    raise OutOfTimeError(f"{batch.queue.n_waiting} of {len(theta)} rows were not begun")
                for future in wait(batch.running, _TICK_S, FIRST_COMPLETED).done:
                    yield from batch.finished(future)
                batch.warn_of_slow_row()
        except KeyboardInterrupt:
            # What still runs is not waited for; what has finished has been paid for.
            for future in [future for future in batch.running if future.done()]:
                yield from batch.finished(future)
            self.close()  # also where all that ran has finished
            raise
        finally:
            if batch.running:
                for future in batch.running:
                    future.cancel()
                self.close()

    def _chosen(self, n: int) -> NewProcess:
        """Return which of n rows begin in a new process."""
        seen = self._seen
        unnoticed_s = _UNNOTICED_S / n if seen.opened_s < _UNNOTICED_IN_ALL_S else 0.0
        allowed_s = max(unnoticed_s, _SMALL_SHARE * (seen.row_s or 0.0))
        is_known = seen.n_openings >= _N_OPENINGS or seen.opening_s > _SURELY_SLOW_S
        if self.always_new or not is_known or seen.opening_s <= allowed_s:
            return NewProcess.EACH_ROW
        return NewProcess.WHEN_NEEDED

    def _submit(self, question: Question) -> "Future[ChunkAnswer | Facts]":
        if self._executor is not None and self._remote is not None:
            return self._executor.submit(self._remote.simulate, question)
        if self._threads is None:
            if self._make_ready is not None:
                self._make_ready(self._on_warning)
            self._threads = ThreadPoolExecutor(self.n_workers, "simulate")
        return self._threads.submit(self._processes.simulate, question)

    def _trajectories(self, theta: FloatArray, y: FloatArray, failures: tuple[str, ...]) -> Trajectories:
        names = self.parameter_space.names
        return Trajectories(theta, y, self.time, names, self.output_names, failures)

    def close(self) -> None:
        """End what works for this model, also in the middle of a row; work starts it again."""
        self._processes.end()
        if self._threads is not None:
            self._threads.shutdown(cancel_futures=True)
            self._threads = None
        self._processes.close()

    def __enter__(self) -> Self:
        """Return the model."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the model."""
        self.close()


class _Batch:
    """The rows of one call: those that wait and those that a process has."""

    def __init__(self, model: PoolModel, theta: FloatArray, new_process: NewProcess | None) -> None:
        self._model = model
        self._theta = theta
        self._wanted = new_process
        self._chunk_s = _CHUNK_S if model._executor is None else _REMOTE_CHUNK_S
        max_rows = max(1, MAX_CHUNK_BYTES // (8 * len(model.time) * len(model.output_names)))
        self.queue = RowQueue(len(theta), chunk_s=self._chunk_s, max_rows=max_rows)
        # Since when, and how long the slowest row before has taken, see ExecutionPolicy.limit_s.
        self.running: dict[Future[ChunkAnswer | Facts], tuple[range, float, float | None]] = {}
        self._n_done, self._reasons = 0, list[str]()
        self._losses: Counter[int] = Counter()
        self._max_running: int | None = None

    def hand_out(self) -> None:
        """Have as many chunks simulated at a time as their rows are worth."""
        model = self._model
        while self.queue.n_waiting and len(self.running) < self._worth_running():
            if self._wanted is NewProcess.AT_FIRST:
                rows, budget_s = self.queue.take(0.0, 1), inf
            else:
                rows = self.queue.take(self._row_s, model.n_workers)
                budget_s = _MAX_OVERRUN * max(self._chunk_s, len(rows) * (self._row_s or 0.0))
            theta, slowest_s = self._theta[rows.start : rows.stop], model._seen.slowest_s
            future = model._submit(Question(theta, budget_s, slowest_s, self._new_process))
            self.running[future] = rows, monotonic(), slowest_s

    @property
    def _new_process(self) -> NewProcess:
        return self._wanted or self._model._chosen(len(self._theta))

    @property
    def _row_s(self) -> float | None:
        """Expected time of a row with what opens its process, None where nothing is known. [s]."""
        seen = self._model._seen
        if seen.row_s is None or self._new_process is not NewProcess.EACH_ROW:
            return seen.row_s
        return seen.row_s + seen.opening_s

    def _worth_running(self) -> int:
        model, processes = self._model, self._model._processes
        n, row_s = model.n_workers, 0.0
        if model._executor is not None:
            # One is on its way while one is simulated.
            return 2 * n
        if self._row_s is not None and model._seen.n_answers >= _N_SURE:
            row_s = self._row_s
        opened_s = monotonic() - max(list(processes.opened.values()), default=inf)
        if (spent_s := min(self._longest_s, opened_s)) > max(row_s, _SURELY_SLOW_S):
            row_s = spent_s
        n_now = max(1, processes.n, len(self.running))
        worth = n_now + int(self.queue.n_waiting * row_s / (n_now * START_PAYS_S))
        return min(n, worth, self._max_running or n)

    def finished(self, future: "Future[ChunkAnswer | Facts]") -> Generator[Finished]:
        """Yield what became of a chunk, and let others have what is left of it."""
        model, (rows, *_) = self._model, self.running.pop(future)
        try:
            answer = future.result()
        except (ProcessLostError, CancelledError, *getattr(model._executor, "lost", ())) as error:
            if model._executor is not None:
                model._on_warning(
                    f"a process of the executor was lost ({type(error).__name__}); the {len(rows)} rows that "
                    "it was given are simulated again"
                )
            self._losses.update(rows)
            n_losses, middle = self._losses[rows.start], len(rows) // 2
            if middle or n_losses <= _MAX_LOSSES:
                self.queue.put(rows[middle:])
                self.queue.put(rows[:middle])
                return
            y = np.full((1, len(model.time), len(model.output_names)), np.nan)
            reason = f"the process that simulated it was lost {n_losses} times"
            answer = ChunkAnswer(y, (reason,), None, np.zeros(1, dtype=np.bool_))
        except (InputError, RuntimeError) as refused:
            n_open = len(model._processes.opened)
            if n_open == 0:
                raise
            # Perhaps there are no more licences.
            if self._max_running is None:
                model._on_warning(
                    f"only {n_open} of {model.n_workers} processes go on, as no more can open the model "
                    f"at once: {refused}"
                )
            self._max_running = n_open
            self.queue.put(rows)
            return
        assert isinstance(answer, ChunkAnswer), "the answer to rows"
        done = rows[: len(answer.failures)]
        self.queue.put(rows[len(done) :])
        model._seen.note(answer)
        theta = self._theta[done.start : done.stop].copy()
        trajectories = model._trajectories(theta, answer.y, answer.failures)
        yield Finished(np.array(done, dtype=np.int64), trajectories, answer.is_first)
        self._n_done += len(done)
        self._reasons += filter(None, answer.failures)
        model._policy.check(self._n_done, self._reasons)

    @property
    def _longest_s(self) -> float:
        """For how long the oldest chunk has been running. [s]."""
        now = monotonic()
        return now - min((since for _, since, _ in self.running.values()), default=now)

    def warn_of_slow_row(self) -> None:
        """Warn, once, of a row that takes much longer than others, or of a model that does not open."""
        model, spent_s = self._model, self._longest_s
        if model._has_warned or spent_s < _SLOW_S:
            return
        rows, _, slowest_s = min(self.running.values(), key=lambda one: one[1])
        if spent_s < (_SLOW_FACTOR + len(rows)) * (model._seen.row_s or 0.0):
            return
        model._has_warned = True
        which = f"row {rows.start}" if len(rows) == 1 else f"one of rows {rows.start} to {rows.stop - 1}"
        model._on_warning(
            f"{which} has been running for {spent_s:.2g} s (with loading the model), which may be a wait for "
            f"a licence; {model._policy.limit_in_words(slowest_s)}"
        )


def available_cores() -> int:
    """Count the cores that this process may use.

    Returns:
        At least 1.
    """
    return len(os.sched_getaffinity(0))
