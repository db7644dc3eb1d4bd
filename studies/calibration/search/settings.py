"""Settings of an adaptive calibration, each with its meaning, and what is refused."""

from dataclasses import dataclass

import numpy as np

from simulation.errors import InputError


@dataclass(frozen=True)
class SearchSettings:
    """How an adaptive calibration searches; what no user sets stands beside its use.

    Attributes:
        n_parallel: Simulations per round.
        ftol: Where the surrogate expects less than this relative gain, a search phase ends; the search ends
            once tests of that, everywhere within the bounds, have found nothing. [1]
        misfit_threshold: Error above which a local minimum is no answer: the search restarts until its
            surrogate excludes half the error everywhere, or stops, without converging, once restarts and
            tests promise no gain; None accepts every one. [first output's unit squared]
        target_mse: Go on to this error or the end of the budget, however little is expected; or None. [first
            output's unit squared]
        max_calls: Most simulations.
    """

    n_parallel: int = 1
    ftol: float = 1e-3
    misfit_threshold: float | None = None
    target_mse: float | None = None
    max_calls: int = 200

    def __post_init__(self) -> None:
        """Refuse settings that no search can run with."""
        for name in ("max_calls", "n_parallel"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or value < 1:
                raise InputError(
                    f"adaptive calibration: {name} is {value}; give a whole number of at least 1"
                )
        for name in ("ftol", "target_mse", "misfit_threshold"):
            value = getattr(self, name)
            if value is not None and not value >= 0.0:
                raise InputError(f"adaptive calibration: {name} is {value}; give at least 0")

    @staticmethod
    def design_size(n_parameters: int) -> int:
        """Return the rows of the first design."""
        # 10, 12 or 18 rows at the start instead of 14 gained
        # nothing (docs/notes/adaptive-search.md, First form).
        return max(n_parameters, 4)
