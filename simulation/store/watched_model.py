"""A stored model that simulates new rows with their states, and stores what it answers as without them."""

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.forward_model import ForwardModel
from simulation.parameters import ParameterSpace
from simulation.pool.pool_model import PoolModel
from simulation.states import StateRows, StateSignals, WatchedModel
from simulation.store.stored_model import StoredModel
from simulation.trajectories import Trajectories

N_UNREAD = 2
"""Rows that fail with their states and not without before states are left alone: one may have bad luck."""


class StoredWatchedModel(StoredModel):
    """A stored model whose new rows are asked of another one that watches the same model's states.

    Rows lie in both stores: with their states in the other one's, and without, for everybody, in its own. An
    FMU may declare states and yet fail where they are read; then rows are asked without from there on.

    Attributes:
        signals: What is known of the states.
        why_unread: Why they cannot be read, "" where they can.
        n_asked_twice: Rows that failed with their states and were asked again without.
    """

    def __init__(
        self,
        plain: StoredModel,
        watched: StoredModel,
        signals: StateSignals,
        *,
        retry_failed: bool = False,
        n_first: int = 1,
    ) -> None:
        """Wrap two models.

        Args:
            plain: Answers without states.
            watched: Answers with them, see `simulation.states.watching_states`.
            signals: What is known of them.
            retry_failed: Ask again, once, for rows that failed before this object was made.
            n_first: Rows that are asked at once while none has succeeded yet.
        """
        super().__init__(plain.unstored, plain.store, retry_failed=retry_failed)
        self.signals = signals
        self.why_unread = ""
        self.n_asked_twice = 0
        self._rows = watched
        self._watched = WatchedModel(watched, signals)
        self._n_first = n_first
        self._are_read = False
        self._n_unread = 0

    # Asked of the model that answers: the other one's processes, and licences, may never be needed.
    @property
    def parameter_space(self) -> ParameterSpace:
        """The model's parameters."""
        return self._watched.parameter_space

    @property
    def output_names(self) -> tuple[str, ...]:
        """The outputs, without what is watched."""
        return self._watched.output_names

    @property
    def time(self) -> FloatArray:
        """Times of the outputs. Shape (t,). [s]."""
        return self._watched.time

    def watched(self, theta: FloatArray) -> BoolArray:
        """Say which rows are stored with their states, failed ones left out.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            Shape (n,).
        """
        return self._rows.store.find(theta) & ~self._rows.store.find_failed(theta)

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
        if not self.missing(theta).any():
            return super().simulate(theta)
        # One after the other: there may be a licence for one of them.
        _end_processes(self._rows.unstored)
        answer = super().simulate(theta)
        _end_processes(self.unstored)
        return answer

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
            rest = theta[n_done:]
            parts.append(super().simulate(rest) if self.why_unread else self._with_states(rest))
        return Trajectories.concatenate(parts)

    def _tried(self, theta: FloatArray) -> Trajectories:
        """Ask rows with their states, and without where that fails: it may be the states that fail."""
        n_failures = len(self.failures)
        answer = self._with_states(theta)
        if not self._rows.store.find_failed(theta).all():
            # An output beyond its band makes its row a failed one, and the states were read all the same.
            self._are_read = True
            return answer
        del self.failures[n_failures:]
        # One after the other: there may be a licence for one of them.
        _end_processes(self._rows.unstored)
        plain = super().simulate(theta)
        self.n_asked_twice += len(theta)
        self._n_unread += int((~plain.failed).sum())
        if self._n_unread >= N_UNREAD:
            self.why_unread = answer.failures[int(np.argmin(plain.failed))]
        else:
            _end_processes(self.unstored)
        return plain

    def _with_states(self, theta: FloatArray) -> Trajectories:
        rows = self._rows
        n_simulated, n_reused = rows.n_simulated, rows.n_reused
        answer = self._watched.simulate_more(theta)
        self.n_simulated += rows.n_simulated - n_simulated
        self.n_reused += rows.n_reused - n_reused
        self.failures += filter(None, answer.failures)
        # What fails where states are read need not fail without.
        is_answer = ~rows.store.find_failed(theta)
        is_better = ~self.store.find(theta) | (self.store.find_failed(theta) & ~answer.failed)
        self.store.append(answer.take(is_answer & is_better))
        return answer


def _end_processes(model: ForwardModel) -> None:
    """End what simulates for a model; work starts it again."""
    if isinstance(model, PoolModel):
        model.close()
