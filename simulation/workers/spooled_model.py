"""What models that simulate elsewhere have in common: rows lie in arenas until whoever asked has them."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import numpy as np

from simulation.arrays import FloatArray
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories
from simulation.workers.arena import Arena, Grid
from simulation.workers.execution import ExecutionPolicy
from simulation.workers.recipe import Facts, Recipe, known_facts
from simulation.workers.tally import Tally

BLOCK_BYTES: Final = 64_000_000
_MAX_BLOCK_ROWS: Final = 65_536
# An arena up to this size is used again, and its rows are copied out of it.
_KEPT_BYTES: Final = 4_000_000


class SpooledModel(ABC):
    """A forward model whose rows are worked off somewhere else, and safe in a spool until they are stored."""

    def __init__(self, make_model: Recipe, *, policy: ExecutionPolicy | None, spool: Path | None) -> None:
        """Start nothing yet.

        Args:
            make_model: Recipe for the model; must be picklable. Where it is the bound method of an object
                that has the model's parameter_space, output_names and time, these are known without opening
                it anywhere.
            policy: What happens to rows that hang, crash or fail.
            spool: Folder in which finished rows survive the death of this process (see recover_arenas); None
                to lose them with it.
        """
        self._policy = policy or ExecutionPolicy()
        self._spool = spool
        self._facts = known_facts(make_model)
        # At most one, for small batches; a list, so that a finalizer can have it.
        self._kept: list[Arena] = []
        self._last: Arena | None = None

    @abstractmethod
    def _ask_for_facts(self) -> Facts:
        """Open the model somewhere and say what it looks like."""

    @abstractmethod
    def _work_off(self, arena: Arena, tally: Tally) -> None:
        """Finish all rows of an arena.

        Raises:
            InputError: If the model cannot be opened, or too many rows fail.
        """

    @abstractmethod
    def _let_go(self, *, at_once: bool) -> None:
        """End what works for this model; the next work starts it again.

        Args:
            at_once: Whether in the middle of a row.
        """

    @property
    def _known(self) -> Facts:
        if self._facts is None:
            self._facts = self._ask_for_facts()
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
        self._fill(arena, theta, Tally(self._policy.max_failed_share))
        answer = arena.trajectories(copied=arena in self._kept)
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
        tally = Tally(self._policy.max_failed_share, on_progress)
        for start in range(0, len(theta), size):
            rows = theta[start : start + size]
            arena = Arena.create(self._grid, len(rows), spool=self._spool)
            try:
                self._fill(arena, rows, tally)
                yield arena.trajectories()
                arena.remove()
            finally:
                # After an error, or where nobody asked for more, the rows may not be stored yet.
                arena.release()

    def _fill(self, arena: Arena, theta: FloatArray, tally: Tally) -> None:
        arena.load(theta)
        try:
            self._work_off(arena, tally)
        except BaseException:
            # Nobody waits for what still runs; finished rows stay in the spool.
            self._let_go(at_once=True)
            self._kept.clear()
            arena.release()
            raise
        tally.close(arena)

    def _arena_for(self, n: int) -> Arena:
        """Return an arena for so many rows: the last one where it is small and fits."""
        for arena in self._kept:
            if arena.capacity >= n:
                return arena
        row_bytes = self._grid.row_bytes
        if n * row_bytes > _KEPT_BYTES:
            return Arena.create(self._grid, n, spool=self._spool)
        arena = Arena.create(self._grid, max(n, min(64, _KEPT_BYTES // row_bytes)), spool=self._spool)
        for smaller in self._kept:
            smaller.remove()
        self._kept[:] = [arena]
        return arena

    def _forget_last(self) -> None:
        """Let go of the rows of the last batch, which are stored by now, or not wanted."""
        if self._last in self._kept:
            self._last.clear()
        elif self._last is not None:
            self._last.remove()
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
        """End what works for this model; closing twice does no harm, and work starts it again."""
        self._forget_last()
        while self._kept:
            self._kept.pop().remove()
        self._let_go(at_once=False)

    def __enter__(self) -> Self:
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
