"""A model that is asked for no row twice: what it answered lies in a store."""

from collections.abc import Callable, Generator
from contextlib import closing
from typing import NoReturn

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.errors import ReuseError
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.pool.pool_model import PoolModel
from simulation.pool.worker_process import NewProcess
from simulation.store.reuse_check import ReuseCheck
from simulation.store.store import SimulationStore
from simulation.trajectories import Trajectories

# Rows that a killed process may lose where the model is no pool, which hands over its own chunks.
BLOCK_ROWS = 64


class StoredModel(WrappedModel):
    """A model around a store: stored rows are read, the others simulated and stored as they come.

    Calls are counted above it, as asked: what a calibration costs does not depend on what is stored already.
    Of rows that shared a process with others some are repeated in other processes (`ReuseCheck`).

    Attributes:
        store: The store of the answers.
        unstored: The model itself, for questions about it: how long it takes, whether it repeats.
        n_simulated: Rows that the model was asked for.
        n_reused: Rows asked of this object that the model was not asked for.
        failures: Why rows failed that `simulate` was asked for, one reason each.
        why_unread: Why states cannot be read, of a model that watches them; "" where they can.
        n_asked_twice: Rows that failed with their states and were asked again without.
    """

    def __init__(
        self,
        model: ForwardModel,
        store: SimulationStore,
        *,
        retry_failed: bool = False,
        pool: PoolModel | None = None,
    ) -> None:
        """Wrap a model.

        Args:
            model: The model to ask.
            store: Where its answers lie.
            retry_failed: Ask the model again, once, for rows that failed before this object was made.
            pool: What simulates in other processes, where that is not the model itself.
        """
        super().__init__(model)
        self.unstored = model
        self.store = store
        self._retry_up_to = store.n_written if retry_failed else 0
        self.n_simulated = self.n_reused = 0
        self.failures: list[str] = []
        self.why_unread, self.n_asked_twice = "", 0
        self._pool = model if isinstance(model, PoolModel) else pool
        self.reuse = ReuseCheck(self._pool)
        if self._pool is not None and store.is_reuse_given_up:
            self._pool.always_new = True

    @property
    def simulation_s(self) -> float | None:
        """Time of a simulation, None where nothing was simulated yet. [s]."""
        return None if self._pool is None else self._pool.simulation_s

    def missing(self, theta: FloatArray) -> BoolArray:
        """Return which rows the model would have to simulate.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            Shape (n,); every repetition of a missing row is missing.
        """
        return ~self.store.find(theta, failed_after=self._retry_up_to)

    def watched(self, theta: FloatArray) -> BoolArray:
        """Return which rows are stored with the courses of the model's states: none, in a model without them.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            Shape (n,).
        """
        return np.zeros(len(theta), dtype=np.bool_)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Read the rows that are stored and simulate the others.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The same as the model answers, bit for bit.

        Raises:
            ReuseError: If rows that shared a process depended on each other; they are removed.
        """
        self.complete(theta)
        answer = self.store.read(theta)
        self.failures += filter(None, answer.failures)
        return answer

    def complete(
        self, theta: FloatArray, *, on_progress: Callable[[int], None] = lambda n_done: None
    ) -> None:
        """Simulate the rows that are not stored, in bounded memory, and store each chunk as it finishes.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            on_progress: Called with the number of rows that are stored so far.

        Raises:
            ReuseError: If rows that shared a process depended on each other; they are removed.
        """
        theta = np.array(theta, dtype=np.float64)
        # Each missing row once, by its exact bytes.
        new = np.array(list({row.tobytes(): row for row in theta[self.missing(theta)]}.values()))
        n_stored = len(theta) - len(new)
        self.n_reused += n_stored
        on_progress(n_stored)
        if not len(new):
            return
        with closing(self._as_finished(new)) as chunks:
            for chunk, is_first in chunks:
                self.store.append(chunk, is_first)
                self.n_simulated += chunk.n
                n_stored += chunk.n
                on_progress(n_stored)
                self._count_reused(is_first)
        if self.reuse.is_open:
            self._check_reuse()

    def _as_finished(self, theta: FloatArray) -> Generator[tuple[Trajectories, BoolArray]]:
        """Yield answers to rows, and which were the first of their process, in any order as they finish."""
        if self._pool is not None:
            with closing(self._pool.as_finished(theta)) as chunks:
                for _, chunk, is_first in chunks:
                    yield chunk, is_first
            return
        for start in range(0, len(theta), BLOCK_ROWS):
            chunk = self._model.simulate(theta[start : start + BLOCK_ROWS])
            yield chunk, np.ones(chunk.n, dtype=np.bool_)

    def _anew(self, theta: FloatArray, new_process: NewProcess) -> Trajectories:
        assert self._pool is not None, "rows are reused by pools alone"
        return self._pool.simulate(theta, new_process)

    def _count_reused(self, is_first: BoolArray) -> None:
        """Take note of rows that were stored, and repeat some where that is due."""
        self.reuse.count(int((~is_first).sum()))
        if self.reuse.is_due:
            self._check_reuse()

    def _check_reuse(self) -> None:
        reused = self.store.theta_reused
        chosen = reused[self.reuse.chosen(len(reused))]
        self.reuse.checked()
        if len(chosen) and not self.reuse.is_repeated(self._anew, self.store.read(chosen)):
            self.give_up_reuse()

    def give_up_reuse(self) -> NoReturn:
        """Remove all rows that shared a process, and give each row a process of its own from now on.

        Raises:
            ReuseError: Always.
        """
        n = self.store.give_up_reuse()
        if self._pool is not None:
            self._pool.always_new = True
        raise ReuseError(
            f"the FMU does not forget one simulation before the next: {n} stored simulations that came after "
            "others in a process are removed, and each simulation gets a process of its own from now on"
        )

    def repeats(self, theta: FloatArray) -> bool:
        """Repeat a stored row in a process of its own.

        Args:
            theta: Parameters of a row that did not fail. Shape (p,). [per parameter]

        Returns:
            Whether it is repeated to the last bit; if not, the FMU is random. True where the model has no
            processes.

        Raises:
            ReuseError: If it depended on rows before it; all that may are removed.
        """
        if self._pool is None:
            return True
        row = theta[None]
        is_first = bool(self.store.first(row)[0])
        if not self.reuse.is_repeated(self._anew, self.store.read(row), is_first=is_first):
            self.give_up_reuse()
        return not self.reuse.is_random
