"""How patiently simulations are run: time-outs, retries, when to stop, how many at once."""

import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from simulation.errors import InputError

SLOWER = 100.0
"""Without a time-out a simulation may take so many times as long as the slowest one before."""

FIRST_LIMIT_S = 86_400.0
"""What a simulation may take that began before any had finished: a day. [s]"""

MIN_ROWS, DEVIATIONS = 20, 2.0
"""Below so many rows a share of failed ones says nothing, and so many standard deviations are bad luck."""

_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")


class TooManyFailuresError(InputError):
    """So many rows failed that going on would waste simulations; the finished ones have been handed over."""


@dataclass(frozen=True)
class ExecutionPolicy:
    """What happens to simulations that hang, crash or fail; nothing here changes what a good one answers.

    Attributes:
        timeout_s: Time after which a simulation is killed; infinite for never; None for `SLOWER` times as
            long as the slowest one before, and a day where none has finished, see `limit_s`. It also ends
            an FMU that takes so long to load or to be instantiated; what opens a model beside that, as
            compiling its loop, has a minute. [s]
        least_limit_s: The least that None allows. [s]
        retries: How often a row whose process died is tried again.
        max_failed_share: Share of failed rows above which a batch stops and says why, once `MIN_ROWS` rows
            have finished and it is no bad luck (`DEVIATIONS`); 1 for never. [1]
        max_workers: Most processes at once, for instance as many as there are licences; None for no limit.
        max_growth_mb: A process that has taken this much more memory than after its first row is replaced
            once its row is finished. [MB]
        whose: What `timeout_s` is where no case file says it, for messages; "" for the case's key.
    """

    timeout_s: float | None = None
    least_limit_s: float = 60.0
    retries: int = 1
    max_failed_share: float = 0.5
    max_workers: int | None = None
    max_growth_mb: float = 500.0
    whose: str = ""

    @property
    def finite_timeout_s(self) -> float | None:
        """The time-out, None where none is given or it is infinite. [s]."""
        return None if self.timeout_s is None or math.isinf(self.timeout_s) else self.timeout_s

    def is_hopeless(self, n: int, n_failed: int) -> bool:
        """Return whether so many of n rows failed that going on would waste simulations."""
        share = self.max_failed_share
        return n >= MIN_ROWS and n_failed > share * n + DEVIATIONS * math.sqrt(share * (1.0 - share) * n)

    def check(self, n: int, reasons: Sequence[str]) -> None:
        """Stop where too many rows have failed by now.

        Args:
            n: Rows that have finished.
            reasons: Why some of them failed.

        Raises:
            TooManyFailuresError: If too many have failed.
        """
        if self.is_hopeless(n, len(reasons)):
            reason, n_times = commonest(reasons)
            raise TooManyFailuresError(
                f"{len(reasons)} of {n} simulations failed, more than simulation.max_failed_share = "
                f"{self.max_failed_share:g} allows; the commonest reason ({n_times} of them): {reason}; "
                "narrow the bounds, mend the model, widen what the case accepts or raise the share"
            )

    def limit_s(self, slowest_s: float | None) -> float:
        """Return the time after which a simulation is killed, infinite for never. [s].

        Args:
            slowest_s: What the slowest simulation so far has taken, None before any has finished. [s]
        """
        if self.timeout_s is not None:
            return self.timeout_s
        return FIRST_LIMIT_S if slowest_s is None else max(self.least_limit_s, SLOWER * slowest_s)

    def why_stopped(self, slowest_s: float | None) -> str:
        """Return why a simulation was killed at its limit.

        Args:
            slowest_s: As for `limit_s`. [s]
        """
        why = ""
        if self.timeout_s is None:
            slowest = (
                "none has finished" if slowest_s is None else f"the slowest before took {slowest_s:.3g} s"
            )
            why = f" (no [simulation] timeout_s is given, and {slowest})"
        elif self.whose:
            why = f" ({self.whose})"
        return f"did not answer within {self.limit_s(slowest_s):.5g} s and was stopped{why}"

    def limit_in_words(self, slowest_s: float | None) -> str:
        """Return, in words, when a long simulation is stopped.

        Args:
            slowest_s: As for `limit_s`, when it began. [s]
        """
        if self.timeout_s is not None:
            return f"{self.whose or '[simulation] timeout_s'} stops it after {self.timeout_s:g} s"
        limit = f"{self.limit_s(slowest_s):.5g} s"
        if slowest_s is not None:
            limit += f" ({SLOWER:g} times the slowest one before, at least {self.least_limit_s:g} s)"
        return f"it is stopped after {limit}; [simulation] timeout_s sets another limit"


def commonest(reasons: Sequence[str]) -> tuple[str, int]:
    """Return why most rows failed, whatever numbers that holds, and how many did; "" and 0 for none.

    Args:
        reasons: Why rows failed; "" for those that are good.
    """
    kinds = Counter(_NUMBER.sub("#", reason) for reason in reasons if reason)
    if not kinds:
        return "", 0
    ((kind, n),) = kinds.most_common(1)
    return next(reason for reason in reasons if _NUMBER.sub("#", reason) == kind), n
