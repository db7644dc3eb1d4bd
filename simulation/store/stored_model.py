"""A model that is asked for no row twice: what it answered lies in a store."""

from contextlib import closing

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.forward_model import ForwardModel, WrappedModel
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
        self._retry_up_to = store.n_written if retry_failed else 0
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
        return ~self._store.find(theta, failed_after=self._retry_up_to)

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
        self.complete(theta)
        answer = self._store.read(theta)
        self.failures += filter(None, answer.failures)
        return answer

    def complete(self, theta: FloatArray, *, on_progress: OnRows | None = None) -> None:
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
        if on_progress is not None:
            on_progress(n_stored)
        if not len(new):
            return
        with closing(as_finished(self._model, new)) as chunks:
            for _, chunk in chunks:
                self._store.append(chunk)
                self.n_simulated += chunk.n
                n_stored += chunk.n
                if on_progress is not None:
                    on_progress(n_stored)
