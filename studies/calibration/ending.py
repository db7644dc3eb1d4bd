"""When a search has converged, and the words for how it ended.

That a surrogate expects little around the best row is not enough: it may be wrong. So the search tests it,
with rounds where a lower error is least unlikely (confirmation.py) and with restarts away from the best row.
What counts are tests since the last gain, and a gain that they found makes the search owe more of them.
"""

from dataclasses import dataclass

import numpy as np

# Rounds of tests that are owed, and how many more each time that they have found a gain. [1]
N_TESTED, N_TESTED_MORE = 5, 3
# Relative gains below this are none: an answer within 0.02 of the best is right. [1]
CONFIRMED = 5e-3
# Restarts that are owed beside with so few parameters: rows are near each other there, so restarts are short.
FEW_PARAMETERS, N_RESTARTS_MORE = 8, 2
# Restarts in vain after which a search stops whose error is too large.
N_RESTARTS_DOUBTED = 8
# So many restarts in a row that begin where everything is excluded end the doubt: there is no deeper valley.
N_EXCLUDED = 2


@dataclass(frozen=True)
class Ending:
    """Why a search ended.

    Attributes:
        reason: In words.
        converged: Whether the target is reached, or nothing more is expected and tests of that found nothing.
    """

    reason: str
    converged: bool


class Confirmation:
    """What has been tested since the last gain."""

    def __init__(self, n_parameters: int, least_restarts: int) -> None:
        """Begin with nothing tested.

        Args:
            n_parameters: Parameters of the problem.
            least_restarts: Restarts that are owed at least; none are owed where that is 0.
        """
        self._n_restarts = least_restarts
        if least_restarts and n_parameters <= FEW_PARAMETERS:
            self._n_restarts += N_RESTARTS_MORE
        self.begin_again()
        self.n_refuted = 0

    def begin_again(self) -> None:
        """Forget all tests, as where another error is minimized."""
        self._best = self.promised = np.inf
        self.n_tested = self.n_restarts = self.n_excluded = 0

    def note_best(self, best: float) -> None:
        """Take note of the best objective; what was tested before a gain does not count. [unit squared]."""
        if best < (1.0 - CONFIRMED) * self._best:
            self.n_refuted += self.n_tested > 0
            self._best = best
            self.n_tested = self.n_restarts = self.n_excluded = 0

    @property
    def tests_owed(self) -> int:
        """Rounds of tests without a gain before the search may end."""
        return N_TESTED + N_TESTED_MORE * self.n_refuted

    @property
    def restarts_owed(self) -> int:
        """Restarts without a gain before the search may end."""
        return self._n_restarts and self._n_restarts + self.n_refuted

    @property
    def is_tested(self) -> bool:
        """Whether no more rounds of tests are owed: enough were made, and nothing is promised in the box."""
        return self.has_tests and self.promised <= CONFIRMED

    @property
    def has_tests(self) -> bool:
        """Whether as many rounds of tests were made as are owed whatever is promised."""
        return self.n_tested >= self.tests_owed

    @property
    def is_excluded(self) -> bool:
        """Whether the surrogate excludes a deeper valley everywhere."""
        return self.n_excluded >= N_EXCLUDED

    @property
    def in_words(self) -> str:
        """What was tested."""
        tests = f"{_counted(self.n_tested, 'round')} of tests where more is least unlikely"
        return tests + (f" and {_counted(self.n_restarts, 'restart')}" if self.n_restarts else "")

    def still_owed(self, ftol: float) -> str:
        """Say of a search that expects less than `ftol` what would confirm that, for one that has to stop."""
        tests = f"{min(self.n_tested, self.tests_owed)} of {self.tests_owed} rounds of tests"
        restarts = f"{min(self.n_restarts, self.restarts_owed)} of {self.restarts_owed} restarts"
        return (
            f"around the best point a gain of less than {ftol:g} of the error is expected, which {tests} and "
            f"{restarts} have confirmed; the next round would go on with these"
        )


def too_large(confirmation: Confirmation) -> Ending:
    """Return the end of a search whose error is more than the sensor explains."""
    return Ending(
        f"{confirmation.in_words} since the last gain of {CONFIRMED:g} found no lower error, though it is "
        "more than the sensor explains",
        converged=False,
    )


def still_falling(n: int, gained: float, expected: float) -> str:
    """Say how a search was falling that has to stop.

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
