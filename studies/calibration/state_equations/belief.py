"""When state equations are believed: while solved rows agree with simulated ones, and few proposals fail."""

from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.largest_samples import outlying_part

# So many points that fail end the belief.
MOST_FAILED = 4
# Squares of the differences between solved and simulated residuals, as shares of a row's error, up to which
# exact equations match it, and up to which they are believed: beyond, the model does something else, as where
# a state jumps. 3 % and 14 % of the residuals, squared. A jump of 0.1 to 0.3 K left all formulas valid, and a
# search that checked these alone ended at 2 to 13 times the error (docs/notes/state-equations.md, Whole
# powers).
MATCHED, BELIEVED = 1e-3, 2e-2


@dataclass
class Belief:
    """What speaks against the equations of an experiment.

    Attributes:
        mismatch: Of solved rows and simulated ones, see `mismatch`. [1]
        n_failed: Points that the equations proposed and whose simulation failed.
        has_failed: Whether the last row that was asked is one of them.
    """

    mismatch: float = 0.0
    n_failed: int = 0
    has_failed: bool = False

    @property
    def is_kept(self) -> bool:
        """Whether equations do what the rows do, and have not led to failures."""
        return self.mismatch <= BELIEVED and self.n_failed < MOST_FAILED

    @property
    def is_sure(self) -> bool:
        """Whether equations match what was simulated: more rows would add nothing."""
        return self.is_kept and self.mismatch <= MATCHED and not self.has_failed


def mismatch(solved: FloatArray, simulated: FloatArray, sensor: float) -> float:
    """Return the greatest squared difference of solved and simulated residuals, as a share of a row's error.

    Args:
        solved: Residuals by the equations. Shape (n, m). [first output's unit]
        simulated: The model's. Shape (n, m). [first output's unit]
        sensor: Uncertainty of the first output's sensor. [its unit]

    Returns:
        The share, infinite where solved residuals are not finite. [1]
    """
    mse = np.mean(simulated**2, axis=1) - [outlying_part(row, sensor) for row in simulated]
    # A row's error counts a little of their median more: that of an exact fit may be next to zero.
    shares = squared_differences(solved, simulated) / (mse + MATCHED * np.median(mse))
    return float(np.max(np.where(np.isfinite(shares), shares, np.inf)))


@np.errstate(all="ignore")
def squared_differences(solved: FloatArray, simulated: FloatArray) -> FloatArray:
    """Return the mean squared differences of residuals (n, m). Shape (n,). [first output's unit squared]."""
    return np.asarray(np.mean((solved - simulated) ** 2, axis=1))
