"""A model that is asked for no row twice: what it answered lies in a store."""

from collections.abc import Callable, Generator
from contextlib import closing

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.store.store import SimulationStore
from simulation.trajectories import Trajectories

# Rows that a killed process may lose where the model is no pool, which hands over its own chunks.
BLOCK_ROWS = 64


class StoredModel(WrappedModel):
    """A model around a store: stored rows are read, the others simulated and stored as they come.

    Calls are counted above it, as asked: what a calibration costs does not depend on what is stored already.

    Attributes:
        store: The store of the answers.
        unstored: The model itself, for questions about it: how long it takes, whether it repeats.
        n_simulated: Rows that the model was asked for.
        n_reused: Rows asked of this object that the model was not asked for.
        failures: Why rows failed that `simulate` was asked for, one reason each.
        why_unread: Why states cannot be read, of a model that watches them; "" where they can.
        n_asked_twice: Rows that failed with their states and were asked again without.
    """

    def __init__(self, model: ForwardModel, store: SimulationStore, *, retry_failed: bool = False) -> None:
        """Wrap a model.

        Args:
            model: The model to ask.
            store: Where its answers lie.
            retry_failed: Ask the model again, once, for rows that failed before this object was made.
        """
        super().__init__(model)
        self.unstored = model
        self.store = store
        self._retry_up_to = store.n_written if retry_failed else 0
        self.n_simulated = self.n_reused = 0
        self.failures: list[str] = []
        self.why_unread, self.n_asked_twice = "", 0

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
            for chunk in chunks:
                self.store.append(chunk)
                self.n_simulated += chunk.n
                n_stored += chunk.n
                on_progress(n_stored)

    def _as_finished(self, theta: FloatArray) -> Generator[Trajectories]:
        """Yield the answers to some rows chunk by chunk, in any order: those of a pool as they finish."""
        if hasattr(self._model, "as_finished"):
            for _, chunk in self._model.as_finished(theta):
                yield chunk
            return
        for start in range(0, len(theta), BLOCK_ROWS):
            yield self._model.simulate(theta[start : start + BLOCK_ROWS])
