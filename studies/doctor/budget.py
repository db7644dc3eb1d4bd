"""The time of an examination: of all its simulations, of one row, and what had to be left out."""

import math
from dataclasses import dataclass, field, replace
from time import monotonic

from simulation.pool.execution import ExecutionPolicy

EXAMINATION_S = 600.0
"""Simulating time of an examination that is not thorough, after its first simulation. [s]"""
SLOWER = 20.0
"""A row may take so many times what the estimates take, and LEAST_S more: corners are harder for a solver."""
LEAST_S = 5.0
OPENINGS = 3.0
"""An opening may take so many times what the first one took: others may open at the same time."""


@dataclass
class TimeBudget:
    """Time of an examination, and what had to be left out to keep it.

    Args:
        n_workers: simulations at once.
        is_thorough: nothing is left out.
        timeout_s: time-out of the case, None for none. [s]
        simulation_s: time of one simulation, once it is known. [s]
        opening_s: time of the first one, with the start of its process and the opening of the FMU. [s]
        limit_s: the examination's own limit. [s]
        left_out: examinations cut short, with what was done instead.
    """

    n_workers: int
    is_thorough: bool
    timeout_s: float | None
    simulation_s: float = 0.0
    opening_s: float = 0.0
    limit_s: float = EXAMINATION_S
    left_out: list[str] = field(default_factory=list)
    _started: float = field(default_factory=monotonic)

    @property
    def until(self) -> float:
        """When all simulations but the first have to end, on the monotonic clock; infinite for never. [s]."""
        return math.inf if self.is_thorough else self._started + self.limit_s

    @property
    def is_over(self) -> bool:
        """Whether no further simulation should start."""
        return monotonic() > self.until

    @property
    def has_own_limit(self) -> bool:
        """Whether a row is stopped by the examination, where the case says nothing of it."""
        return self.timeout_s is None and not self.is_thorough

    @property
    def row_limit_s(self) -> float:
        """The examination's own limit of a row. [s]."""
        # A process of its own opens the FMU first, which may take longer than a row.
        return LEAST_S + SLOWER * self.simulation_s + OPENINGS * self.opening_s

    def begin(self) -> None:
        """Let the time count from now on: the first simulation is over, however long it took."""
        self._started = monotonic()

    def first_policy(self, policy: ExecutionPolicy) -> ExecutionPolicy:
        """Return how patiently the first simulation is run: as the case says, as long as that may take."""
        return replace(policy, max_failed_share=1.0)

    def policy(self, policy: ExecutionPolicy, more_s: float = 0.0) -> ExecutionPolicy:
        """Return how patiently all others are run, without an end when many fail.

        Args:
            policy: the case's.
            more_s: time that is added to the time-out. [s]
        """
        timeout_s = self.row_limit_s if self.has_own_limit else self.timeout_s
        timeout_s = None if timeout_s is None else timeout_s + more_s
        whose = "the limit of this check" if self.has_own_limit else ""
        return replace(policy, timeout_s=timeout_s, max_failed_share=1.0, whose=whose)

    def rows(self, what: str, wanted: int, least: int = 1, *, at_once: bool = True) -> int:
        """Return how many simulations an examination may have, and remember what it has to do without.

        Args:
            what: the examination, in words.
            wanted: simulations it asks for.
            least: fewer say nothing.
            at_once: whether all workers share them.
        """
        if self.is_thorough:
            return wanted
        left = self.until - monotonic()
        rounds = int(left / self.simulation_s) if self.simulation_s > 0.0 else wanted
        affordable = max(0, rounds) * (self.n_workers if at_once else 1)
        if affordable >= wanted:
            return wanted
        given = affordable if affordable >= least else 0
        self.left_out.append(f"{what} ({given} of {wanted} simulations)" if given else what)
        return given

    def say_missing(self, what: str, n_done: int, n: int, n_slow: int) -> None:
        """Remember an examination of which not all simulations have finished.

        Args:
            what: the examination, in words.
            n_done: simulations that have finished.
            n: simulations that it asked for.
            n_slow: simulations that took longer than a row may.
        """
        slow = f", {n_slow} took longer than {self.row_limit_s:.3g} s" if n_slow else ""
        if n_done < n:
            self.left_out.append(f"{what} ({n_done} of {n} simulations{slow})")
