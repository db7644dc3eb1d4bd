"""Whether simulations that share a process depend on each other: some are repeated in other processes."""

from collections.abc import Callable
from math import inf

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.pool.pool_model import PoolModel
from simulation.pool.worker_process import NewProcess
from simulation.trajectories import Trajectories

# The first check comes after so many simulations, the next one where there are four times as many, and one
# more at the end of each batch: what an FMU accumulates, or one of two processes does, shows late.
FIRST_CHECK, NEXT_CHECK = 80, 4
# A check repeats so many quick simulations, each in a process of its own, chosen from those since the check
# before. A switch that is left as it was in one of two processes changes one simulation in five: two checks
# miss it once in a hundred times. Repeated in one process they might change in the same way again.
N_REPEATED = 10
# Of slower simulations, or where a process opens slowly, one in SHARE is repeated, all in one process.
SHARE = 20
# What is as short is quick, process or simulation; a process that opens more slowly may cost this share of
# the time of what it is to check. [s], [1]
QUICK_S, TIME_SHARE = 0.3, 0.1

Repeat = Callable[[FloatArray, NewProcess], Trajectories]
"""Simulates rows anew, with nothing read or stored."""


class ReuseCheck:
    """Chooses simulations that are repeated, and says whether they were repeated well.

    Attributes:
        n_repeated: Simulations that were repeated so far.
        is_random: Whether an FMU was found that answers the same parameters in two new processes differently.
    """

    def __init__(self, pool: PoolModel | None) -> None:
        """Begin with no reused simulation seen.

        Args:
            pool: What simulates, None for a model without processes.
        """
        self._pool = pool
        self._n_reused = self._n_unchecked = 0
        self._next = FIRST_CHECK
        self.n_repeated = 0
        self.is_random = False

    def count(self, n_reused: int) -> None:
        """Take note of simulations that shared a process with others before them."""
        self._n_reused += n_reused
        self._n_unchecked += n_reused

    @property
    def _is_quick(self) -> bool:
        return max(self._opening_s, self._simulation_s) <= QUICK_S

    @property
    def _opening_s(self) -> float:
        return inf if self._pool is None else self._pool.opening_s

    @property
    def _simulation_s(self) -> float:
        return 0.0 if self._pool is None else self._pool.simulation_s or 0.0

    @property
    def is_due(self) -> bool:
        """Whether so many more simulations were reused that some should be repeated."""
        return self._n_reused >= self._next and not self.is_random

    @property
    def is_open(self) -> bool:
        """Whether so many were reused since the last check that some may be repeated."""
        share_s = TIME_SHARE * self._n_unchecked * self._simulation_s
        is_dear = self._opening_s > QUICK_S and self._opening_s + self._simulation_s > share_s
        return self._n_unchecked >= SHARE and not is_dear and not self.is_random

    def chosen(self, n_stored: int) -> IntArray:
        """Choose simulations to repeat from those since the last check.

        Args:
            n_stored: Reused simulations in the store, of which they are the last ones.

        Returns:
            Their positions in the order of storing, in the order of repeating. Shape (m,).
        """
        n_new = min(self._n_unchecked, n_stored)
        n = min(N_REPEATED if self._is_quick else max(1, n_new // SHARE), n_new)
        generator = np.random.default_rng([n_stored, self._n_reused])
        return np.asarray(n_stored - n_new + generator.choice(n_new, n, replace=False), dtype=np.int64)

    def checked(self) -> None:
        """Take note that what was reused so far is checked."""
        self._n_unchecked = 0
        while self._next <= self._n_reused:
            self._next *= NEXT_CHECK

    def is_repeated(self, repeat: Repeat, stored: Trajectories, *, is_first: bool = False) -> bool:
        """Repeat simulations in new processes: quick ones in one each, others in one, one after the other.

        Args:
            repeat: Simulates them anew.
            stored: What the model answered, none of them failed.
            is_first: Whether each of them was the first of its process.

        Returns:
            Whether all are repeated to the last bit, or the FMU is random: then nothing shows what depends on
            what.
        """
        asked = stored.theta
        self.n_repeated += len(asked)
        how = NewProcess.EACH_ROW if self._is_quick else NewProcess.AT_FIRST
        differs = _differ(repeat(asked, how), stored)
        if not differs.any():
            return True
        if is_first and len(asked) == 1:
            self.is_random = True
            return True
        self.n_repeated += 2
        first = repeat(np.repeat(asked[differs][:1], 2, axis=0), NewProcess.EACH_ROW)
        self.is_random = bool(_differ(first.take([0]), first.take([1]))[0])
        return self.is_random


def _differ(one: Trajectories, other: Trajectories) -> BoolArray:
    """Return which of the same rows differ in a bit; where one failed a time-out may have been the reason."""
    is_other = np.any(one.y != other.y, axis=(1, 2))
    return np.asarray(is_other & ~one.failed & ~other.failed)
