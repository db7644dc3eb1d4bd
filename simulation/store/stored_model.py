"""A model that is asked for no row twice: what it answered lies in a store."""

from collections.abc import Iterator
from contextlib import closing

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.store.index import row_keys
from simulation.store.store import SimulationStore
from simulation.streaming import OnRows, as_finished
from simulation.trajectories import Trajectories


class StoredModel(WrappedModel):
    """A model around a store: known rows are read, the others simulated and stored as they come.

    Calls are counted above it, as asked: what a calibration costs does not depend on what is stored already.

    Attributes:
        n_simulated: Rows that the model was asked for.
        n_reused: Rows asked of this object that the model was not asked for.
        failures: Why rows failed that `simulate` was asked for, one reason each.
    """

    def __init__(self, model: ForwardModel, store: SimulationStore, *, retry_failed: bool = False) -> None:
        """Wrap a model.

        Args:
            model: The model to ask.
            store: Where its answers lie.
            retry_failed: Ask the model again, once, for rows that failed before this object was made.
        """
        super().__init__(model)
        self._store = store
        self._retry_before = store.now() if retry_failed else None
        self.n_simulated = self.n_reused = 0
        self.failures: list[str] = []

    @property
    def store(self) -> SimulationStore:
        """Where the answers lie."""
        return self._store

    @property
    def unstored(self) -> ForwardModel:
        """The model itself, for questions about it: how long it takes, whether it repeats."""
        return self._model

    def missing(self, theta: FloatArray) -> BoolArray:
        """Say which rows the model would have to be asked for.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            Shape (n,); every repetition of a missing row is missing.
        """
        missing = ~self._store.find(theta)
        if self._retry_before is not None:
            missing |= self._store.find_failed(theta, before=self._retry_before)
        return missing

    def watched(self, theta: FloatArray) -> BoolArray:
        """Say which rows are stored with what the model's states did: none, where nobody watches them.

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
        """
        theta = np.array(theta, dtype=np.float64)
        new = self._first_missing(theta)
        if len(new) == len(theta):
            answer = self._ask_all(theta)
        else:
            self._ask(theta, new, None)
            answer = self._read(theta)
        self.failures += filter(None, answer.failures)
        return answer

    def stream(self, theta: FloatArray, *, on_progress: OnRows | None = None) -> Iterator[Trajectories]:
        """Simulate the rows that are not stored, then read all of them block by block.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            on_progress: Called with the number of rows that are stored or finished so far.

        Yields:
            Consecutive blocks of rows, in order.
        """
        theta = np.array(theta, dtype=np.float64)
        self.complete(theta, on_progress=on_progress)
        yield from self.stored(theta)

    def stored(self, theta: FloatArray) -> Iterator[Trajectories]:
        """Read rows that are complete, block by block; one that turns out to be damaged is simulated again.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Yields:
            Consecutive blocks of rows, in order.
        """
        size = self._store.rows_per_block
        for start in range(0, len(theta), size):
            yield self._read(np.array(theta[start : start + size], dtype=np.float64))

    def complete(self, theta: FloatArray, *, on_progress: OnRows | None = None) -> None:
        """Simulate and store the rows that are not stored, in bounded memory.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            on_progress: Called with the number of rows that are stored or finished so far.
        """
        theta = np.array(theta, dtype=np.float64)
        self._ask(theta, self._first_missing(theta), on_progress)

    def _ask(self, theta: FloatArray, new: IntArray, on_progress: OnRows | None) -> None:
        """Simulate and store some of the rows."""
        n_known = len(theta) - len(new)
        self.n_reused += n_known

        def advance(n_done: int) -> None:
            if on_progress is not None:
                on_progress(n_known + n_done)

        advance(0)
        if len(new):
            n_done = 0
            with closing(as_finished(self._model, theta[new])) as chunks:
                for _, chunk in chunks:
                    self._store.append(chunk)
                    self.n_simulated += chunk.n
                    n_done += chunk.n
                    advance(n_done)

    def _read(self, theta: FloatArray) -> Trajectories:
        """Read rows that are stored, and simulate again what turns out to be damaged."""
        while True:
            try:
                return self._store.read(theta)
            except LookupError:
                new = self._first_missing(theta)
                self.n_reused -= len(theta)
                self._ask(theta, new, None)

    def _ask_all(self, theta: FloatArray) -> Trajectories:
        """Simulate rows of which none is stored, without reading them back."""
        y = np.empty((len(theta), len(self.time), len(self.output_names)))
        failures = [""] * len(theta)
        with closing(as_finished(self._model, theta)) as chunks:
            for rows, chunk in chunks:
                self._store.append(chunk)
                y[rows] = chunk.y
                for row, reason in zip(rows.tolist(), chunk.failures, strict=True):
                    failures[row] = reason
                self.n_simulated += chunk.n
        return Trajectories(
            theta, y, self.time, self.parameter_space.names, self.output_names, tuple(failures)
        )

    def _first_missing(self, theta: FloatArray) -> IntArray:
        """Return the first occurrence of each missing row, in order."""
        missing = np.flatnonzero(self.missing(theta))
        _, first = np.unique(row_keys(theta[missing]), return_index=True)
        return np.asarray(missing[np.sort(first)])
