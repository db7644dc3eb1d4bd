"""Where simulations are expected to succeed: as often as those next to the place did."""

from dataclasses import dataclass

import numpy as np

from simulation.arrays import BoolArray, FloatArray

# At an edge half to two thirds of the rows fail, before 94 to 96 of 96 (docs/notes/uncertainty.md).
N_NEAREST = 5
"""Rows that are asked."""

LEAST = 1e-3
"""Share of success where all of them failed: the model may be otherwise in between."""


@dataclass(frozen=True, eq=False)
class Succeeding:
    """Rows that were simulated, and which of them failed.

    Attributes:
        u: Points. Shape (n, p). [1]
        failed: Which failed. Shape (n,).
        precision: What is near: of the density around its best point. Shape (p, p). [1]
    """

    u: FloatArray
    failed: BoolArray
    precision: FloatArray

    def log_probability(self, u: FloatArray) -> FloatArray:
        """Return the logarithm of the share of the nearest rows that succeeded, 0 where none has ever failed.

        Args:
            u: Points. Shape (m, p). [1]

        Returns:
            Shape (m,). [1]
        """
        if not self.failed.any():
            return np.zeros(len(u))
        # In the density's own widths: in the unit cube a narrow one's edge is not seen (60 to 83 of 96 fail).
        root = np.linalg.cholesky(self.precision)
        known, asked = self.u @ root, np.clip(u, 0.0, 1.0) @ root
        # But for what all distances from a point have in common.
        distances = np.sum(known**2, axis=1) - 2.0 * asked @ known.T
        # Stable: rows at equal distance keep their order, so a seed gives the same sample on every machine.
        nearest = np.argsort(distances, axis=1, kind="stable")[:, :N_NEAREST]
        share = 1.0 - self.failed[nearest].mean(axis=1)
        value: FloatArray = np.log(np.maximum(share, LEAST))
        return value
