"""How far into the trajectories a search looks: where the whole is not understood, its beginning may be.

The phase error of whatever oscillates or switches grows with time. Over many periods the error as a function
of the parameters is full of valleys, over the first one it has few; and a simulation that was paid for may be
judged by its beginning for nothing. So a search that is lost looks at a short beginning first, and at twice
as much whenever it has understood what it sees.
"""

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.measurement import Measurement

# Shares of an output's measured variance that the best row leaves unexplained, by the mean squared error.
LOST, UNDERSTOOD = 0.25, 0.02
# Where nothing more is gained in a beginning, less is enough to look further: sensors have noise too.
CLEAR = 0.1
SHORTEST = 1.0 / 32.0


class Horizon:
    """The part of the residuals, from the first on, that a search minimizes."""

    def __init__(self, measurement: Measurement) -> None:
        """Begin with all of them.

        Args:
            measurement: What the residuals are differences to; says which of them belong to which output.
        """
        n_outputs = len(measurement.output_names)
        zero = np.zeros((1, len(measurement.time), n_outputs))
        signal = -measurement.compared(zero)[0]
        # A residual belongs to the output that moves it.
        moved = measurement.compared(zero + np.eye(n_outputs)[:, None]) + signal
        self._is_of: BoolArray = moved > 0.5 * moved.max(axis=0)
        self._variance = np.array([signal[of].var() for of in self._is_of])
        # What varies less than its sensor errs, as a room at its set point, says nothing where another does.
        is_flat = self._variance <= (measurement.scales * measurement.uncertainty) ** 2
        if not is_flat.all():
            self._variance[is_flat] = 0.0
        self._part = 1.0

    @property
    def is_whole(self) -> bool:
        """Whether the search looks at everything."""
        return self._part == 1.0

    def seen(self, residuals: FloatArray) -> FloatArray:
        """Return the part of the residuals that the search looks at. Shape (..., n)."""
        return residuals[..., : int(np.ceil(self._part * residuals.shape[-1]))]

    def unexplained(self, residuals: FloatArray) -> float:
        """Return the mean squared error in the seen part by the variance measured, of the worst output. [1].

        Args:
            residuals: Of one row, all of them. Shape (m,). [first output's unit]
        """
        seen = self.seen(residuals)
        shares = [
            float(np.mean(seen[of[: seen.size]] ** 2)) / variance
            for of, variance in zip(self._is_of, self._variance, strict=True)
            if variance > 0.0 and of[: seen.size].any()
        ]
        return max(shares, default=0.0)

    def shorten(self) -> None:
        """Look at the shortest beginning."""
        self._part = SHORTEST

    def lengthen(self) -> None:
        """Look twice as far."""
        self._part = min(2.0 * self._part, 1.0)
