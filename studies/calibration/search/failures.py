"""Where simulations are expected to fail: a Gaussian process of which rows failed, as a penalty.

An optimum that a surrogate expects beyond the edge of what can be simulated would be asked for again and
again. The process has the value 0 where a row succeeded and 1 where it failed. Where it expects more than
`FAILED_SHARE`, the objective that the search minimizes grows with the square of the rest; what a row counts
for stays its objective. Where no row has failed nothing changes.
"""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.prior import Prior
from studies.calibration.processes.kernel import Belief, most_probable
from studies.calibration.processes.process import Components, Features, ResidualProcess

# Expected share of failures from which a place is penalized, and the penalty where all fail, in objectives of
# the simulation that a step begins at. Penalized from 0.5 on, 32 % of the calls failed instead of 24 %
# (docs/notes/adaptive-search.md, Failed simulations).
FAILED_SHARE, FAILED_WEIGHT = 0.3, 10.0


class Penalty(Protocol):
    """What a search adds to the expected error: a prior, failures, or both."""

    def penalty(self, u: FloatArray) -> FloatArray:
        """Return it at points (n, p). Shape (n,). [unit squared]."""

    def expand(self, u: FloatArray) -> Expansion:
        """Expand it around a point (p,)."""


@dataclass(frozen=True, eq=False)
class Failures:
    """The penalty of failures on top of a prior's; make it with `fit`.

    Attributes:
        process: Of which rows failed.
        prior: Of the parameters, None where nothing is known.
        scale: Objective that the penalty is a multiple of. [unit squared]
    """

    process: ResidualProcess
    prior: Prior | None
    scale: float

    @classmethod
    def fit(
        cls,
        features: Features,
        u: FloatArray,
        failed: BoolArray,
        prior: Prior | None,
        first_guess: FloatArray | None,
        *,
        scale: float,
        refits: bool = True,
    ) -> Self:
        """Fit the process to all rows that were asked, of which some failed and some did not.

        Args:
            features: The coordinates that the kernel shall see.
            u: Points. Shape (n, p). [1]
            failed: Which failed. Shape (n,).
            prior: Of the parameters, None where nothing is known.
            first_guess: Hyperparameters of an earlier fit to start from. Shape (f + 2,). [1]
            scale: Objective of the row that a step begins at. [unit squared]
            refits: Whether hyperparameters are fitted again, or those of the first guess taken.
        """
        x, values = features.at(u), failed[:, None].astype(np.float64)
        # As residuals of a single sample that is 0 in the best row, all known equally well.
        components = Components(values, np.zeros(1), 0.0, np.zeros(1), 1, np.ones(len(u)))
        hyper = first_guess
        if hyper is None or refits:
            belief = Belief.of(x.shape[1])
            hyper = most_probable(x, values, components.looseness, belief, first_guess)
        return cls(ResidualProcess.through(features, x, components, hyper), prior, scale)

    def penalty(self, u: FloatArray) -> FloatArray:
        """Return the penalty at points (n, p). Shape (n,). [unit squared]."""
        return np.array([self.expand(point).value for point in u])

    def expand(self, u: FloatArray) -> Expansion:
        """Expand the penalty around a point (p,)."""
        k, dk = self.process.kernels(u)
        # The expected share of failures, as far as it is penalized, and its slope.
        share = max(float((k @ self.process.coefficients)[0]) - FAILED_SHARE, 0.0)
        slope = (share > 0.0) * (dk.T @ self.process.coefficients[:, 0])
        weight = self.scale * FAILED_WEIGHT
        # A square begins with slope zero, so that Newton steps see no kink at the edge.
        curvature = 2.0 * weight * np.outer(slope, slope)
        penalty = Expansion.known(weight * share**2, 0.0, 2.0 * weight * share * slope, curvature)
        return penalty if self.prior is None else penalty + self.prior.expand(u)
