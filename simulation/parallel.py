"""A forward model that lives in supervised worker processes: a crash, a hang or a leak costs one row."""

import contextlib
import logging
import os
import threading
import weakref
from collections.abc import Callable, Iterator
from multiprocessing import parent_process
from multiprocessing.connection import wait
from pathlib import Path
from types import TracebackType
from typing import Final

import numpy as np

from simulation.arena import Arena, Grid
from simulation.arrays import FloatArray
from simulation.campaign import Campaign, Record
from simulation.execution import ExecutionPolicy
from simulation.parameters import ParameterSpace
from simulation.recipe import Facts, Recipe, known_facts
from simulation.trajectories import Trajectories
from simulation.workforce import Workforce

_LOG = logging.getLogger(__name__)
BLOCK_BYTES: Final = 64_000_000
_MAX_BLOCK_ROWS: Final = 65_536
# An arena up to this size is used again, and its rows are copied out of it.
_KEPT_BYTES: Final = 4_000_000


class ParallelModel:
    """A model whose every row is simulated in a worker process, never in this one.

    Workers start with the first row, as many as the rows are worth, and stay until close(). The answer is the
    same, bit for bit, whoever simulates which row. Not for use from several threads at once.
    """

    def __init__(
        self,
        make_model: Recipe,
        n_workers: int | None = None,
        *,
        policy: ExecutionPolicy | None = None,
        spool: Path | None = None,
        on_warning: Callable[[str], None] | None = None,
    ) -> None:
        """Start nothing yet.

        Args:
            make_model: Recipe for the model; must be picklable. Where it is the bound method of an object
                that has the model's parameter_space, output_names and time, these are known without a worker.
            n_workers: Most worker processes; None for one per core that this process may use.
            policy: What happens to rows that hang, crash or fail.
            spool: Folder in which finished rows survive the death of this process (see recover_arenas); None
                to lose them with it.
            on_warning: Told, in one line, what a user should know at once; None for the log.
        """
        if n_workers is not None and n_workers < 1:
            raise ValueError(f"n_workers is {n_workers}; at least one process has to work")
        self._policy = policy or ExecutionPolicy()
        self._n_workers = min(n_workers or available_cores(), self._policy.max_workers or 2**31)
        self._spool = spool
        self._on_warning = on_warning or _LOG.warning
        self._workforce = Workforce(
            make_model, self._n_workers, policy=self._policy, on_warning=self._on_warning
        )
        self._facts = known_facts(make_model)
        self._arenas: list[Arena] = []
        self._last: Arena | None = None
        self._row_s: float | None = None
        self._n_loads = 0
        self._finalizer = weakref.finalize(self, _abandon, self._workforce, self._arenas)

    @property
    def _known(self) -> Facts:
        if self._facts is None:
            self._facts = self._workforce.open()
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

    @property
    def n_workers(self) -> int:
        """Most worker processes that rows are spread over."""
        return self._n_workers

    @property
    def n_processes(self) -> int:
        """Worker processes that there are now."""
        return self._workforce.n_processes

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The same trajectories as from one process, bit for bit. With a spool, they are safe there until
            the next call.

        Raises:
            InputError: If the model cannot be opened, or too many rows fail (CampaignStopped).
        """
        theta = self._checked(theta)
        self._forget_last()
        if not len(theta):
            return self._nothing()
        arena = self._arena_for(len(theta))
        self._simulate(arena, theta, Record(), None)
        answer = arena.trajectories(copied=arena.is_kept)
        self._last = arena
        if self._spool is None:
            self._forget_last()
        return answer

    def stream(
        self, theta: FloatArray, *, on_progress: Callable[[int], None] | None = None
    ) -> Iterator[Trajectories]:
        """Simulate every row, a block at a time: memory does not grow with the number of rows.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            on_progress: Told how many rows have finished so far.

        Yields:
            Consecutive rows. With a spool, a block is safe there until the next is asked for.

        Raises:
            InputError: If the model cannot be opened, or too many rows fail (CampaignStopped).
        """
        theta = self._checked(theta)
        size = max(1, min(_MAX_BLOCK_ROWS, BLOCK_BYTES // self._grid.row_bytes))
        record = Record()
        for start in range(0, len(theta), size):
            rows = theta[start : start + size]
            arena = Arena.create(self._grid, len(rows), spool=self._spool)
            try:
                self._simulate(arena, rows, record, on_progress)
                yield arena.trajectories()
                arena.remove()
            finally:
                # After an error, or where nobody asked for more, the rows may not be stored yet.
                arena.release()

    def _simulate(
        self, arena: Arena, theta: FloatArray, record: Record, on_progress: Callable[[int], None] | None
    ) -> None:
        arena.load(theta)
        self._n_loads += 1
        record.row_s = record.row_s if record.row_s is not None else self._row_s
        campaign = Campaign(
            arena,
            self._n_loads,
            self._workforce,
            policy=self._policy,
            record=record,
            on_progress=on_progress,
            on_warning=self._on_warning,
        )
        try:
            campaign.run()
        except BaseException:
            # Nobody waits for what still runs; finished rows stay in the arena.
            self._workforce.close(at_once=True)
            self._arenas.clear()
            arena.release()
            raise
        self._row_s = record.row_s

    def _arena_for(self, n: int) -> Arena:
        """Return an arena for so many rows: the last one where it is small and fits."""
        for arena in self._arenas:
            if arena.capacity >= n:
                return arena
        if n * self._grid.row_bytes > _KEPT_BYTES:
            return Arena.create(self._grid, n, spool=self._spool)
        fitting = _KEPT_BYTES // self._grid.row_bytes
        arena = Arena.create(self._grid, min(max(2 * n, 64), max(n, fitting)), spool=self._spool)
        arena.is_kept = True
        for smaller in self._arenas:
            smaller.remove()
        self._arenas[:] = [arena]
        return arena

    def _forget_last(self) -> None:
        """Let go of the rows of the last batch, which are stored by now, or not wanted."""
        if self._last is not None and not self._last.is_kept:
            self._last.remove()
        elif self._last is not None:
            self._last.clear()
        self._last = None

    def _checked(self, theta: FloatArray) -> FloatArray:
        theta = np.asarray(theta, dtype=np.float64)
        n_parameters = self.parameter_space.n_parameters
        if theta.ndim != 2 or theta.shape[1] != n_parameters:
            raise ValueError(f"theta has shape {theta.shape}; expected (n, {n_parameters})")
        return theta

    @property
    def _grid(self) -> Grid:
        known = self._known
        return Grid(known.parameter_space.names, known.output_names, known.time)

    def _nothing(self) -> Trajectories:
        grid = self._grid
        return Trajectories.checked(
            np.empty((0, len(grid.parameter_names))),
            np.empty((0, len(grid.time), len(grid.output_names))),
            time=grid.time,
            parameter_names=grid.parameter_names,
            output_names=grid.output_names,
        )

    def close(self) -> None:
        """End the workers, which close their models; closing twice does no harm, and work opens it again."""
        self._forget_last()
        for arena in self._arenas:
            arena.remove()
        self._arenas.clear()
        self._workforce.close()

    def __enter__(self) -> "ParallelModel":
        """Return the model."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the model."""
        self.close()


def _abandon(workforce: Workforce, arenas: list[Arena]) -> None:
    """End the workers of a forgotten model; rows that may not be stored stay in the spool."""
    workforce.close(at_once=True)
    for arena in arenas:
        arena.release()


def available_cores() -> int:
    """Count the cores that this process may use.

    Returns:
        At least 1.
    """
    with contextlib.suppress(AttributeError):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def exit_with_parent() -> None:
    """Make this process end at once when the process that started it ends, however that happens.

    For the first line of a worker of multiprocessing. Without it, workers of a killed parent go on for ever.
    """
    parent = parent_process()
    if parent is None:
        return
    sentinel = parent.sentinel

    def watch() -> None:
        wait([sentinel])
        # Not sys.exit: nothing here is worth finishing, and only the main thread could.
        os._exit(1)

    threading.Thread(target=watch, name="exit-with-parent", daemon=True).start()
