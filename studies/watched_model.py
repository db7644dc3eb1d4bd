"""A stored model that simulates new rows with their states, and stores what it answers as without them."""

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.forward_model import ForwardModel
from simulation.pool.pool_model import PoolModel
from simulation.store.stored_model import StoredModel
from simulation.trajectories import Trajectories
from studies.calibration.states import StateRows, StateSignals, WatchedModel

N_UNREAD = 2
"""Rows that fail with their states and not without before states are left alone: one may have bad luck."""


class StoredWatchedModel(StoredModel):
    """A stored model whose new rows are asked of another one that watches the same model's states.

    Rows lie in both stores: with their states in the other one's, and without, for all other stages, in its
    own. An FMU may declare states and yet fail where they are read; then rows are asked without from there
    on.

    Attributes:
        signals: What is known of the states.
        why_unread: Why they cannot be read, "" where they can.
        n_asked_twice: Rows that failed with their states and were asked again without.
    """

    def __init__(
        self,
        plain: StoredModel,
        watched: StoredModel,
        signals: StateSignals | WatchedModel,
        *,
        n_first: int = 1,
    ) -> None:
        """Wrap two models.

        Args:
            plain: Answers without states.
            watched: Answers with them, see `studies.calibration.states.watching_states`.
            signals: What is known of them, or the model that remembers them.
            n_first: Rows that are asked at once while none has succeeded yet.
        """
        self._watched = signals if isinstance(signals, WatchedModel) else WatchedModel(watched, signals)
        # What it looks like is asked of the model that answers: the other one may never be needed.
        super().__init__(self._watched, plain.store)
        self.signals = self._watched.signals
        self.why_unread = ""
        self.n_asked_twice = 0
        self._plain, self._rows = plain, watched
        self._n_first = n_first
        self._are_read = False
        self._n_unread = 0

    @property
    def watching(self) -> WatchedModel:
        """What remembers the states."""
        return self._watched

    @property
    def unstored(self) -> ForwardModel:
        """The model itself, without states."""
        return self._plain.unstored

    def watched(self, theta: FloatArray) -> BoolArray:
        """Say which rows are stored with their states, failed ones left out.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            Shape (n,).
        """
        return self._rows.store.find_good(theta)

    def seen(self, theta: FloatArray) -> StateRows:
        """Return what states and outputs did in rows of the last simulation, NaN where that is not known.

        Args:
            theta: Their parameters, as they were answered. Shape (n, p). [per parameter]
        """
        return self._watched.seen(theta)

    def known(self, theta: FloatArray, watched: BoolArray) -> Trajectories:
        """Read rows that are stored, some with their states; what has got lost is simulated again.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            watched: Which of them have states. Shape (n,).

        Returns:
            The same as the model answers, bit for bit.
        """
        self._watched.forget()
        if watched.any():
            self._with_states(theta[watched])
            self._are_read = True
        return self._counted(self._without_states(theta))

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Read the rows that are stored with their states and simulate the others.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The same as the model answers without states, bit for bit.
        """
        theta = np.array(theta, dtype=np.float64)
        parts, n_done = [], 0
        self._watched.forget()
        while n_done < len(theta) and not (self._are_read or self.why_unread):
            parts.append(self._tried(theta[n_done : n_done + self._n_first]))
            n_done += parts[-1].n
        if n_done < len(theta) or not parts:
            ask = self._plain.simulate if self.why_unread else self._with_states
            parts.append(ask(theta[n_done:]))
        return self._counted(Trajectories.concatenate(parts))

    def _tried(self, theta: FloatArray) -> Trajectories:
        """Ask rows with their states, and without where that fails: it may be the states that fail."""
        answer = self._with_states(theta)
        if self.watched(theta).any():
            # An output beyond its band makes its row a failed one, and the states were read all the same.
            self._are_read = True
            return answer
        plain = self._without_states(theta)
        self.n_asked_twice += len(theta)
        self._n_unread += int((~plain.failed).sum())
        if self._n_unread >= N_UNREAD:
            self.why_unread = answer.failures[int(np.argmin(plain.failed))]
        return plain

    def _with_states(self, theta: FloatArray) -> Trajectories:
        answer = self._watched.simulate_more(theta)
        # What fails where states are read need not fail without.
        is_better = ~self.store.find(theta) | (~self.store.find_good(theta) & ~answer.failed)
        self.store.append(answer.take(self.watched(theta) & is_better))
        return answer

    def _without_states(self, theta: FloatArray) -> Trajectories:
        # One after the other: there may be a licence for one of them.
        _end_processes(self._rows.unstored)
        answer = self._plain.simulate(theta)
        _end_processes(self._plain.unstored)
        return answer

    def _counted(self, answer: Trajectories) -> Trajectories:
        self.n_simulated = self._plain.n_simulated + self._rows.n_simulated
        self.n_reused = self._plain.n_reused + self._rows.n_reused
        self.failures += filter(None, answer.failures)
        return answer


def _end_processes(model: ForwardModel) -> None:
    """End what simulates for a model; work starts it again."""
    if isinstance(model, PoolModel):
        model.close()
