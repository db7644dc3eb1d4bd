"""How long an examination may simulate: a slow model is examined with as few simulations as fit."""

import time
from dataclasses import dataclass, field

EXAMINATION_S = 120.0
"""Simulating time of an examination that is not thorough. [s]"""
FIRST_S = 600.0
"""Longest that the first simulation may take where the case names no time-out. [s]"""
SLOWER = 20.0
"""A row may take so many times what the estimates take, and LEAST_S more: corners are harder for a solver."""
LEAST_S = 5.0


@dataclass
class TimeBudget:
    """Time of an examination, and what had to be left out to keep it.

    Args:
        n_workers: simulations at once.
        is_thorough: nothing is left out.
        timeout_s: time-out of the case, None for none. [s]
        simulation_s: time of one simulation, once it is known. [s]
        opening_s: time of the first one, with the start of its process and the opening of the FMU. [s]
        left_out: examinations cut short, with what was done instead.
    """

    n_workers: int
    is_thorough: bool
    timeout_s: float | None
    simulation_s: float = 0.0
    opening_s: float = 0.0
    left_out: list[str] = field(default_factory=list)
    _started: float = field(default_factory=time.perf_counter)

    @property
    def is_over(self) -> bool:
        """Whether no further simulation should start."""
        return not self.is_thorough and time.perf_counter() - self._started > EXAMINATION_S

    @property
    def first_timeout_s(self) -> float | None:
        """Time-out of the first simulation. [s]."""
        return self.timeout_s if self.timeout_s is not None or self.is_thorough else FIRST_S

    @property
    def row_timeout_s(self) -> float | None:
        """Time-out of the other simulations. [s]."""
        if self.timeout_s is not None or self.is_thorough:
            return self.timeout_s
        return LEAST_S + SLOWER * self.simulation_s

    def with_opening(self, timeout_s: float | None) -> float | None:
        """Return the time-out of a simulation that opens the FMU itself. [s]."""
        return None if timeout_s is None else timeout_s + SLOWER * self.opening_s

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
        left = EXAMINATION_S - (time.perf_counter() - self._started)
        rounds = int(left / self.simulation_s) if self.simulation_s > 0.0 else wanted
        affordable = max(0, rounds) * (self.n_workers if at_once else 1)
        if affordable >= wanted:
            return wanted
        given = affordable if affordable >= least else 0
        self.left_out.append(f"{what} ({given} of {wanted} simulations)" if given else what)
        return given
