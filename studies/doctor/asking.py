"""Simulations within the time of an examination; what has finished is kept for the study."""

from contextlib import closing
from dataclasses import dataclass

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.pool.pool_model import PoolModel
from simulation.pool.worker_process import NewProcess
from simulation.store.store import SimulationStore
from simulation.trajectories import Trajectories
from studies.doctor.budget import TimeBudget
from studies.doctor.finding import STOPPED

NOT_DONE = "was not simulated"
"""Why a row has no answer that the time was not enough for."""


@dataclass(frozen=True, eq=False)
class Asked:
    """What has been answered in time.

    Args:
        rows: places of the answered rows among those that were asked, rising. Shape (m,).
        answer: their answers, m rows.
        n: number of rows that were asked.
    """

    rows: IntArray
    answer: Trajectories
    n: int

    @property
    def is_whole(self) -> bool:
        """Whether all were answered."""
        return len(self.rows) == self.n

    @property
    def done(self) -> BoolArray:
        """Which rows were answered. Shape (n,)."""
        return np.isin(np.arange(self.n), self.rows)

    def one(self, row: int) -> Trajectories | None:
        """Return the answer to one row, None where there is none."""
        found = np.flatnonzero(self.rows == row)
        return self.answer.take(found) if len(found) else None

    def whole(self, theta: FloatArray) -> Trajectories:
        """Return an answer to all rows, in which those without one have failed.

        Args:
            theta: The rows. Shape (n, p). [per parameter]
        """
        y = np.full((self.n, *self.answer.y.shape[1:]), np.nan)
        failures = np.full(self.n, NOT_DONE, dtype=object)
        y[self.rows], failures[self.rows] = self.answer.y, self.answer.failures
        names = self.answer.parameter_names, self.answer.output_names
        return Trajectories(theta, y, self.answer.time, *names, tuple(failures.tolist()))


class TimedModel:
    """Asks a pool until the time of an examination is over."""

    def __init__(self, pool: PoolModel, budget: TimeBudget, store: SimulationStore | None = None) -> None:
        """Wrap a pool.

        Args:
            pool: The pool.
            budget: The time.
            store: Where finished rows lie, which are not asked again; None to keep nothing. Rows that took
                too long are not kept: others may wait longer for them.
        """
        self._pool, self._budget, self._store = pool, budget, store
        names = pool.parameter_space.names
        nothing = np.empty((0, len(pool.time), len(pool.output_names)))
        empty = Trajectories(np.empty((0, len(names))), nothing, pool.time, names, pool.output_names, ())
        self._known = empty

    @property
    def known(self) -> Trajectories:
        """All good rows that were answered so far."""
        return self._known

    def add(self, rows: Trajectories, *, is_first: bool) -> None:
        """Keep rows that another pool answered, the first of their process or not."""
        self._keep(rows, np.full(rows.n, is_first))
        self._known = Trajectories.concatenate([self._known, rows.take(~rows.failed)])

    def ask(self, theta: FloatArray, what: str, new_process: NewProcess | None = None) -> Asked:
        """Simulate rows, and say what could not be finished in time.

        Where the limit of a row is the check's own, a row that was stopped is none that failed.

        Args:
            theta: Parameters, no row twice. Shape (n, p). [per parameter]
            what: The examination, in words.
            new_process: Which rows are the first of their process; None for what the pool says.
        """
        budget, parts, places, n_slow = self._budget, [self._known.take([])], [np.empty(0, np.int64)], 0
        missing = np.ones(len(theta), dtype=np.bool_) if self._store is None else ~self._store.find(theta)
        if self._store is not None and not missing.all():
            places.append(np.flatnonzero(~missing))
            parts.append(self._store.read(theta[~missing]))
        new = np.flatnonzero(missing)
        with closing(self._pool.as_finished(theta[new], new_process, until=budget.until)) as chunks:
            for rows, chunk, is_first in chunks:
                self._keep(chunk, is_first)
                chosen = _finished(chunk) if budget.has_own_limit else np.ones(chunk.n, dtype=np.bool_)
                n_slow += int(np.count_nonzero(~chosen))
                places.append(new[rows[chosen]])
                parts.append(chunk.take(chosen))
        at, answer = np.concatenate(places), Trajectories.concatenate(parts)
        order = np.argsort(at)
        found = Asked(at[order], answer.take(order), len(theta))
        # In the order of the rows, whoever finished first.
        self._known = Trajectories.concatenate([self._known, found.answer.take(~found.answer.failed)])
        budget.say_missing(what, len(at), len(theta), n_slow)
        return found

    def _keep(self, rows: Trajectories, is_first: BoolArray) -> None:
        """Store rows that have finished, unless they are stored."""
        if self._store is not None:
            new = _finished(rows) & ~self._store.find(rows.theta)
            self._store.append(rows.take(new), is_first[new])


def _finished(rows: Trajectories) -> BoolArray:
    return np.array([STOPPED not in reason for reason in rows.failures], dtype=np.bool_)
