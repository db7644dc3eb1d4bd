"""Settings of an adaptive calibration, each with its meaning, and what is refused."""

from dataclasses import dataclass

import numpy as np

from simulation.errors import InputError


@dataclass(frozen=True)
class SearchSettings:
    """How an adaptive calibration searches.

    Attributes:
        n_start: Rows of the first, space-filling design; as many as parameters when None, at least 4. [1]
        margin: Part of each coordinate's range that the first design leaves out at both ends. [1]
        caution: Part of the predictive variance that counts as error: 0 trusts the surrogate's mean. [1]
        radius: First half width of the trust region in the unit cube. [1]
        least_radius: Half width below which a bad step no longer shrinks it, only failures do. [1]
        n_descents: Descents on the surrogate per round, the first from the best row. [1]
        n_parallel: Rows asked per round.
        ftol: Where the surrogate expects less than this relative gain, a search phase ends; the search ends
            once tests of that, all over the box, have found nothing. [1]
        patience: Rounds without expectation or gain before a phase away from the best row ends. [1]
        stall_rounds: Rounds within which a phase must gain `stall_gain`, or it ends too. [1]
        stall_gain: The relative gain that a phase owes. [1]
        least_restarts: Least number of restarts away from the best row, for problems with several valleys,
            before a search may converge; 0 never leaves the first valley. [1]
        misfit_threshold: Error above which a valley is no answer: the search restarts until its surrogate
            excludes half the error everywhere, or stops, without converging, once restarts and tests promise
            no gain; None accepts every valley. [first output's unit squared]
        target_mse: Go on to this error or the end of the budget, however little is expected; or None. [first
            output's unit squared]
        max_calls: Most rows that may be asked of the model.
    """

    n_start: int | None = None
    margin: float = 0.15
    caution: float = 0.1
    # A wider first trust region gained nothing (docs/notes/adaptive-search.md, First form).
    radius: float = 0.3
    least_radius: float = 0.05
    n_descents: int = 3
    n_parallel: int = 1
    ftol: float = 1e-3
    patience: int = 3
    stall_rounds: int = 10
    stall_gain: float = 0.02
    least_restarts: int = 1
    misfit_threshold: float | None = None
    target_mse: float | None = None
    max_calls: int = 200

    def __post_init__(self) -> None:
        """Refuse settings that no search can run with."""
        counts = {"max_calls": 1, "n_descents": 1, "n_parallel": 1, "patience": 1, "stall_rounds": 1}
        for name, least in (counts | {"least_restarts": 0, "n_start": 2}).items():
            value = getattr(self, name)
            if value is None and name == "n_start":
                continue
            if not isinstance(value, int | np.integer) or value < least:
                raise InputError(
                    f"adaptive calibration: {name} is {value}; give a whole number of at least {least}"
                )
        for name in ("ftol", "stall_gain", "target_mse", "misfit_threshold"):
            value = getattr(self, name)
            if value is not None and not value >= 0.0:
                raise InputError(f"adaptive calibration: {name} is {value}; give at least 0")
        if not 0.0 <= self.margin < 0.5:
            raise InputError(f"adaptive calibration: margin is {self.margin}; give a value in [0, 0.5)")
        if not self.caution >= 0.0:
            raise InputError(f"adaptive calibration: caution is {self.caution}; give at least 0")
        if not 0.0 < self.least_radius <= self.radius <= 1.0:
            raise InputError(
                f"adaptive calibration: least_radius is {self.least_radius} and radius {self.radius}; "
                "give 0 < least_radius <= radius <= 1"
            )

    def design_size(self, n_parameters: int) -> int:
        """Return the rows of the first design."""
        # 10, 12 or 18 rows at the start instead of 14 gained
        # nothing (docs/notes/adaptive-search.md, First form).
        return self.n_start or max(n_parameters, 4)
