"""The trust region: how far from a search phase's best point the next one may lie."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from simulation.arrays import FloatArray

# First half width (a wider one gained nothing: docs/notes/adaptive-search.md, First form).
FIRST_RADIUS = 0.3
# Half width below which a bad step no longer shrinks it, only failures do. By hand.
LEAST_RADIUS = 0.05
# Half width to which failures shrink it. By hand.
SMALLEST_RADIUS = 1e-4
# Shares of the expected gain from and below which a step widens or shrinks it. By hand, as is usual (Conn,
# Gould and Toint, 2000, doi:10.1137/1.9780898719857); wider ones: the same note, Two kernels.
GOOD_STEP, BAD_STEP = 0.5, 0.1
# Share of the half width from which a step lies at the edge. By hand.
AT_THE_EDGE = 0.9
# Factors of the half width. By hand.
GROW, SHRINK, SHRINK_AFTER_FAILURE = 1.5, 0.7, 0.5


@dataclass(frozen=True)
class TrustRegion:
    """A cube around the point that a search phase goes on from.

    Attributes:
        radius: Its half width in the unit cube. [1]
    """

    radius: float = FIRST_RADIUS

    @property
    def is_whole(self) -> bool:
        """Whether no failures have shrunk it below where bad steps end to."""
        return self.radius >= LEAST_RADIUS

    def widened(self) -> Self:
        """Return it without what failures have shrunk."""
        return type(self)(max(self.radius, LEAST_RADIUS))

    def is_at_edge(self, step: FloatArray) -> bool:
        """Return whether a step (p,) [1] from the centre may have been held back."""
        return bool(np.abs(step).max() > AT_THE_EDGE * self.radius)

    def after(self, step: FloatArray, objectives: FloatArray, gain: float, expected: float) -> Self:
        """Return it widened or shrunk by what a round has brought.

        Args:
            step: From the centre to the favourite. Shape (p,). [1]
            objectives: Of the round. Shape (q,). [unit squared]
            gain: How much lower the least of them is than the centre's. [unit squared]
            expected: The gain that the favourite was expected to bring. [unit squared]
        """
        radius = self.radius
        if not np.isfinite(objectives).any():
            radius = max(radius * SHRINK_AFTER_FAILURE, SMALLEST_RADIUS)
        elif gain < BAD_STEP * expected:
            # A radius that failures have made smaller than the
            # least one is left as it is: no bad step widens it.
            radius = max(radius * SHRINK, min(radius, LEAST_RADIUS))
        # A good step inside of the region shows no need of a wider one.
        elif gain > GOOD_STEP * expected and self.is_at_edge(step):
            radius = min(radius * GROW, 1.0)
        return type(self)(radius)
