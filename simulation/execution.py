"""How patiently a campaign of simulations is run: time-outs, retries, when to stop, how many at once."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ExecutionPolicy:
    """What happens to simulations that hang, crash or fail; nothing here changes what a good one answers.

    Attributes:
        timeout_s: Time after which a simulation is killed; None for never: there is no hidden one. [s]
        retries: How often a row whose process died is tried again; one that timed out is not.
        max_failed_share: Share of failed rows above which a campaign stops and says why. [1]
        max_workers: Most processes at once, for instance as many as there are licences; None for no limit.
    """

    timeout_s: float | None = None
    retries: int = 1
    max_failed_share: float = 0.5
    max_workers: int | None = None

    def __post_init__(self) -> None:
        if self.timeout_s is not None and not (self.timeout_s > 0 and math.isfinite(self.timeout_s)):
            raise ValueError(f"timeout_s is {self.timeout_s}; give seconds above 0, or None for no time-out")
        if self.retries < 0:
            raise ValueError(f"retries is {self.retries}; give 0 or more")
        if not 0 < self.max_failed_share <= 1:
            raise ValueError(f"max_failed_share is {self.max_failed_share}; give a share up to 1")
        if self.max_workers is not None and self.max_workers < 1:
            raise ValueError(f"max_workers is {self.max_workers}; at least one process has to work")
