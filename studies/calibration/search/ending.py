"""When a search has converged, and the words for how it ended.

A surrogate that expects little gain around the best row may be wrong. So the search makes rounds of tests
(confirmation.py): they minimize functions drawn from the surrogate, any of which may be the model. Between
the tests it restarts away from the best row. Only tests and restarts since the last gain count. The search
has converged where the minima of these functions promise next to no gain; else it stops, and says how much
they promise.
"""

from dataclasses import dataclass, field

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.search.constants import SEARCH


@dataclass(frozen=True)
class Ending:
    """Why a search ended.

    Attributes:
        reason: In words.
        converged: Whether the target is reached, or nothing more is expected and tests of that found nothing.
    """

    reason: str
    converged: bool


@dataclass
class Confirmation:
    """What has been tested since the last gain.

    Attributes:
        best: Best objective at that gain. [unit squared]
        n_restarts: Restarts since then.
        gains: Of every round of tests the relative gains at minima of functions drawn for it. [1]
        n_owed: Restarts without gain before a search may converge.
    """

    best: float = np.inf
    n_restarts: int = 0
    gains: list[FloatArray] = field(default_factory=list)
    n_owed: int = SEARCH.restarts_owed

    def after(self, best: float, outlying: float = 0.0) -> "Confirmation":
        """Return the tests that still count at a lowest objective: none made before a gain.

        Args:
            best: The objective. [unit squared]
            outlying: Its largest samples' part, without which gains are measured. [unit squared]
        """
        # `best` moves at such a gain alone, so that many small gains together count as one.
        is_gain = best - outlying < (1.0 - SEARCH.confirmed) * (self.best - outlying)
        return Confirmation(best, n_owed=self.n_owed) if is_gain else self

    def note_test(self, gains: FloatArray) -> None:
        """Take note of a round of tests."""
        self.gains.append(gains)

    @property
    def n_tested(self) -> int:
        """Rounds of tests."""
        return len(self.gains)

    @property
    def promised(self) -> float:
        """Gain over the best row at minima of functions that may be the true one, a quantile. [1]."""
        return float(np.quantile(self.gains, SEARCH.quantile)) if self.gains else np.inf

    @property
    def is_promising(self) -> bool:
        """Whether more gain is promised than what makes an answer wrong."""
        return self.promised > SEARCH.promised

    @property
    def is_tested(self) -> bool:
        """Whether there was a round of tests since the last restart."""
        return self.n_tested > self.n_restarts

    @property
    def has_looked(self) -> bool:
        """Whether the restarts that are owed were made."""
        return self.n_restarts >= self.n_owed

    @property
    def in_words(self) -> str:
        """What was tested."""
        tests = f"{_counted(self.n_tested, 'round')} of tests where more is least unlikely"
        return tests + (f" and {_counted(self.n_restarts, 'restart')}" if self.n_restarts else "")

    @property
    def in_vain(self) -> str:
        """That all tests were in vain."""
        return f"{self.in_words} since the last gain of {SEARCH.confirmed:g} found no lower error"

    def ending(self, *, switches: bool, is_too_large: bool = False) -> Ending:
        """Return the end of a search that has made all tests and restarts.

        Args:
            switches: Whether the model switches at times that depend on its parameters: functions that are
                drawn are smooth, and cannot promise what another number of switchings would gain.
            is_too_large: Whether the error is above the misfit threshold.
        """
        if is_too_large:
            return Ending(f"{self.in_vain}, though it is more than the sensor explains", converged=False)
        # Four of six thermostats had said "converged" and were wrong (docs/calibration.md).
        if switches:
            return Ending(
                f"{self.in_vain}; the model switches at times that depend on its parameters, so that another "
                "minimum is not excluded",
                converged=False,
            )
        if self.is_promising:
            return Ending(f"{self.in_vain}, and no more is expected around the best point", converged=False)
        return Ending(
            f"what is known of the model promises no gain above {SEARCH.promised:g} of the error anywhere in "
            f"the box, and {self.in_words} gained no more",
            converged=True,
        )

    def still_owed(self, ftol: float) -> str:
        """Say which tests and restarts are left to a search that expects less than `ftol` and has to stop."""
        if self.is_tested and self.has_looked:
            return (
                f"a gain of up to {self.promised:.2g} of the error is not excluded in the box; "
                "another seed begins anew"
            )
        owed = self.n_owed
        tests = f"{min(self.n_tested, owed + 1)} of {owed + 1} rounds of tests"
        restarts = f"{min(self.n_restarts, owed)} of {owed} restarts"
        return (
            f"around the best point a gain of less than {ftol:g} of the error is expected, which {tests} and "
            f"{restarts} have confirmed; the next round would go on with these"
        )


def still_falling(n: int, gained: float, expected: float) -> str:
    """Describe the last gains of a search that has to stop.

    Args:
        n: Simulations that are looked back at.
        gained: Part of the error that they gained. [1]
        expected: Part that the surrogate expected of the last round. [1]
    """
    hope = f"; the surrogate expected {expected:.2g} of the last round" if np.isfinite(expected) else ""
    return (
        f"the last {_counted(n, 'simulation')} gained {gained:.2g} of the error{hope}; the next round would "
        "go on from the best point"
    )


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
