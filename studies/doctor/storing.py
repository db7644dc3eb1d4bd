"""Storing what an examination simulates, except the rows that only its short time-out stopped."""

import numpy as np

from simulation.arrays import FloatArray
from simulation.forward_model import WrappedModel
from simulation.store.stored_model import StoredModel
from simulation.trajectories import Trajectories

STOPPED = "was stopped"
"""What the reason of a row says that ran into a time-out."""
MORE_TIME = "say how long one simulation may take: [simulation] timeout_s; or wait: --thorough"
"""What to do about it."""


class StoringModel(WrappedModel):
    """A stored model that does not store rows that took too long, as others may wait longer for them."""

    def __init__(self, model: StoredModel) -> None:
        """Wrap a stored model.

        Args:
            model: The model to ask.
        """
        super().__init__(model)
        self._stored = model

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Read the rows that are stored and simulate the others.

        Args:
            theta: Parameters, no row twice. Shape (n, p). [per parameter]
        """
        missing = self._stored.missing(theta)
        known, new = np.flatnonzero(~missing), np.flatnonzero(missing)
        parts = [self._stored.store.read(theta[known])] if len(known) else []
        if len(new):
            parts.append(self._stored.unstored.simulate(theta[new]))
            self.store_finished(parts[-1])
        return Trajectories.concatenate(parts).take(np.argsort(np.concatenate([known, new])))

    def store_finished(self, rows: Trajectories) -> None:
        """Store rows of any model that finished, unless they are stored."""
        finished = np.array([STOPPED not in reason for reason in rows.failures], dtype=np.bool_)
        self._stored.store.append(rows.take(finished & ~self._stored.store.find(rows.theta)))
