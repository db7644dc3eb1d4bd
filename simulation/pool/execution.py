"""How patiently simulations are run: time-outs, retries, when to stop, how many at once."""

import math
from dataclasses import dataclass

from simulation.errors import InputError

SLOWER = 100.0
"""Without a time-out a simulation may take so many times as long as the slowest one before."""

FIRST_LIMIT_S = 86_400.0
"""What a simulation may take that began before any had finished: a day. [s]"""

MIN_ROWS, DEVIATIONS = 20, 2.0
"""Below so many rows a share of failed ones says nothing, and so many standard deviations are bad luck."""


class TooManyFailuresError(InputError):
    """So many rows failed that going on would waste simulations; the finished ones have been handed over."""


@dataclass(frozen=True)
class ExecutionPolicy:
    """What happens to simulations that hang, crash or fail; nothing here changes what a good one answers.

    Attributes:
        timeout_s: Time after which a simulation is killed; infinite for never; None for `SLOWER` times as
            long as the slowest one before, and a day where none has finished, see `limit_s`. [s]
        least_limit_s: The least that None allows. [s]
        opening_s: Time after which an FMU that is loaded or instantiated is killed; None for never. With a
            time-out, what opens a model beside that, as compiling its loop, has a minute. [s]
        retries: How often a row whose process died is tried again.
        timeout_retries: How often a row that was killed at its time-out is tried again.
        max_failed_share: Share of failed rows above which a batch stops and says why, once `MIN_ROWS` rows
            have finished and it is no bad luck (`DEVIATIONS`); 1 for never. [1]
        max_workers: Most processes at once, for instance as many as there are licences; None for no limit.
        max_growth_mb: A process that has taken this much more memory than after its first row is replaced
            once its row is finished. [MB]
        max_rows_per_process: A process that has simulated this many rows is replaced; None for never.
    """

    timeout_s: float | None = None
    least_limit_s: float = 60.0
    opening_s: float | None = None
    retries: int = 1
    timeout_retries: int = 0
    max_failed_share: float = 0.5
    max_workers: int | None = None
    max_growth_mb: float = 500.0
    max_rows_per_process: int | None = None

    def __post_init__(self) -> None:
        if self.timeout_s is not None and not self.timeout_s > 0:
            raise ValueError(f"timeout_s is {self.timeout_s}; give seconds above 0, infinite for no time-out")
        for name in ("retries", "timeout_retries"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} is {getattr(self, name)}; give 0 or more")
        if not 0 < self.max_failed_share <= 1:
            raise ValueError(f"max_failed_share is {self.max_failed_share}; give a share up to 1")
        if self.max_workers is not None and self.max_workers < 1:
            raise ValueError(f"max_workers is {self.max_workers}; at least one process has to work")
        if not self.max_growth_mb > 0:
            raise ValueError(f"max_growth_mb is {self.max_growth_mb}; give megabytes above 0")
        if self.max_rows_per_process is not None and self.max_rows_per_process < 1:
            raise ValueError(f"max_rows_per_process is {self.max_rows_per_process}; give at least 1")

    def is_hopeless(self, n: int, n_failed: int) -> bool:
        """Tell whether so many of n rows failed that going on would waste simulations."""
        share = self.max_failed_share
        return n >= MIN_ROWS and n_failed > share * n + DEVIATIONS * math.sqrt(share * (1.0 - share) * n)

    def limit_s(self, slowest_s: float | None) -> float:
        """Return the time after which a simulation is killed, infinite for never. [s].

        Args:
            slowest_s: What the slowest simulation so far has taken, None before any has finished. [s]
        """
        if self.timeout_s is not None:
            return self.timeout_s
        return FIRST_LIMIT_S if slowest_s is None else max(self.least_limit_s, SLOWER * slowest_s)

    def why_stopped(self, slowest_s: float | None) -> str:
        """Say why a simulation was killed at its limit.

        Args:
            slowest_s: As for `limit_s`. [s]
        """
        why = ""
        if self.timeout_s is None:
            slowest = (
                f"the slowest before took {slowest_s:.3g} s" if slowest_s is not None else "none has finished"
            )
            why = f" (no [simulation] timeout_s is given, and {slowest})"
        return f"did not answer within {self.limit_s(slowest_s):.5g} s and was stopped{why}"
