"""Robust losses: how little a large difference counts, so that outliers do not move parameters."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from simulation.arrays import FloatArray

LossKind = Literal["huber", "soft-l1"]

USUAL_SCALE = 2.0
"""Scale of a loss by the sensor's uncertainty: of normal noise, 1 in 20 samples lies beyond. [1]"""


@dataclass(frozen=True)
class RobustLoss:
    """A loss rho(d) that is d² for small differences d and grows in proportion to |d| for large ones.

    "huber" is d² up to the scale c and 2 c |d| - c² beyond (Huber 1964, doi:10.1214/aoms/1177703732);
    "soft-l1" is 2 c² (sqrt(1 + (d / c)²) - 1), the same without a kink in its slope.
    Least squares minimizes it when d is replaced by sign(d) sqrt(rho(d)).

    Attributes:
        kind: Name of the loss.
        scale: Difference c from which on it bends. [output's unit]
    """

    kind: LossKind
    scale: float

    def shrunk(self, differences: FloatArray) -> FloatArray:
        """Return sign(d) sqrt(rho(d)) of differences d. Shape as they have. [output's unit]."""
        size, c = np.abs(differences), self.scale
        if self.kind == "soft-l1":
            # Without the difference of a root and 1, small values keep all digits; infinite ones become NaN.
            with np.errstate(invalid="ignore"):
                return differences * np.sqrt(2.0 * c / (c + np.hypot(c, size)))
        beyond = np.sqrt(2.0 * c) * np.sqrt(np.maximum(size, c) - 0.5 * c)
        return np.where(size <= c, differences, np.copysign(beyond, differences))

    def grown(self, shrunk: FloatArray) -> FloatArray:
        """Return the differences of which `shrunk` makes these. Shape as they have. [output's unit]."""
        size, c = np.abs(shrunk), self.scale
        if self.kind == "soft-l1":
            return shrunk * np.hypot(1.0, 0.5 * size / c)
        beyond = 0.5 * (np.maximum(size, c) ** 2 / c + c)
        return np.where(size <= c, shrunk, np.copysign(beyond, shrunk))

    def scatter(self, differences: FloatArray) -> FloatArray:
        """Return how far differences would scatter that are normal and leave a fit by squares as uncertain.

        The variance of a fit follows from that of psi, half the slope of the loss, and from the mean slope of
        psi, as in Huber 1964, Eq. 1.

        Args:
            differences: Those of a good fit. Shape (m,). [output's unit]

        Returns:
            psi by the root of its mean slope. Shape (m,). [output's unit]
        """
        c, share = self.scale, differences / self.scale
        if self.kind == "soft-l1":
            psi, slope = differences / np.hypot(1.0, share), np.hypot(1.0, share) ** -3.0
        else:
            psi, slope = np.clip(differences, -c, c), np.where(np.abs(share) <= 1.0, 1.0, 0.0)
        # Where every difference lies beyond the scale, one is thought to lie within.
        return np.asarray(psi / np.sqrt(max(float(slope.mean()), 1.0 / slope.size)))
