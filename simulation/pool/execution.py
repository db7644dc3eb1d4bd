"""How patiently simulations are run: time-outs, retries, when to stop, how many at once."""

import math
from dataclasses import dataclass

from simulation.errors import InputError


class TooManyFailuresError(InputError):
    """So many rows failed that going on would waste simulations; the finished ones have been handed over."""


@dataclass(frozen=True)
class ExecutionPolicy:
    """What happens to simulations that hang, crash or fail; nothing here changes what a good one answers.

    Attributes:
        timeout_s: Time after which a simulation is killed; None for never: there is no hidden one. [s]
        opening_s: Time after which an FMU that is loaded or instantiated is killed; None for never. With a
            time-out, what opens a model beside that, as compiling its loop, has a minute. [s]
        retries: How often a row whose process died is tried again.
        timeout_retries: How often a row that was killed at its time-out is tried again.
        max_failed_share: Share of failed rows above which a batch stops and says why, once 20 rows have
            finished and it is no bad luck (two standard deviations); 1 for never. [1]
        max_workers: Most processes at once, for instance as many as there are licences; None for no limit.
        max_growth_mb: A process that has taken this much more memory than after its first row is replaced
            once its row is finished. [MB]
        max_rows_per_process: A process that has simulated this many rows is replaced; None for never.
    """

    timeout_s: float | None = None
    opening_s: float | None = None
    retries: int = 1
    timeout_retries: int = 0
    max_failed_share: float = 0.5
    max_workers: int | None = None
    max_growth_mb: float = 500.0
    max_rows_per_process: int | None = None

    def __post_init__(self) -> None:
        if self.timeout_s is not None and not (self.timeout_s > 0 and math.isfinite(self.timeout_s)):
            raise ValueError(f"timeout_s is {self.timeout_s}; give seconds above 0, or None for no time-out")
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
