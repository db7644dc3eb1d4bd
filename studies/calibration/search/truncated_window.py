"""The truncated window: the first part of the trajectories, which a search fits before the whole.

The phase error of an oscillation or of switching grows with time. Over many periods the error as a function
of the parameters has many minima, over the first period it has few. Judging a simulated row by its first part
costs no call. So a search that explains too little fits a short window first, and doubles it whenever the
window is explained.
"""

from dataclasses import replace

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.measurement import Measurement
from studies.calibration.search.switching import switches
from studies.calibration.search.trajectory_features import N_BLOCKS, TrajectoryFeatures

# First truncated window, as a share of the whole (docs/notes/adaptive-search.md, Truncated windows).
SHORTEST = 1.0 / 32.0
# Fewest samples in a block of time of which features are taken. By hand.
LEAST_BLOCK = 8
# A share of a feature's squares counts so many times a share of the measured variance. By hand.
FEATURE_WEIGHT = 2.0


class TruncatedWindow:
    """What a search minimizes: all residuals, the first ones, or differences of features."""

    def __init__(self, measurement: Measurement) -> None:
        """Begin with all of them.

        Args:
            measurement: The target, which also says which residual belongs to which output.
        """
        zero = np.zeros((1, len(measurement.time), len(measurement.output_names)))
        plain = [replace(one, loss=None, correlation_s=0.0) for one in measurement.outputs]
        self._measurement = measurement
        # Compared with zero, all that is left is the measurement, scaled and ordered as residuals are.
        self._measured = signal = -replace(measurement, outputs=tuple(plain)).compared(zero)[0]
        self._output_of = measurement.output_of
        # What limits say belongs to no measured output.
        self._is_of: BoolArray = measurement.target_of == np.array(measurement.measured)[:, None]
        self._variance = np.array([signal[of].var() for of in self._is_of])
        # An output that varies less than its sensor errs, as a room at its set point, counts only alone.
        sensor = (measurement.scales * measurement.uncertainty)[list(measurement.measured)]
        is_flat = self._variance <= sensor**2
        if not is_flat.all():
            self._variance[is_flat] = 0.0
        self._features: TrajectoryFeatures | None = None
        self._part = 1.0
        # None until a search has shown whether it explains enough.
        self.was_needed: bool | None = None

    @property
    def is_whole(self) -> bool:
        """Whether all residuals are minimized."""
        return self._part == 1.0 and self._features is None

    def seen(self, residuals: FloatArray) -> FloatArray:
        """Return the residuals in the window, of those of rows (..., m), or features. Shape (..., n)."""
        if self._features is not None:
            return self._features.differences(self._simulated(residuals))
        return residuals[..., : int(np.ceil(self._part * residuals.shape[-1]))]

    @property
    def seen_of(self) -> IntArray:
        """Output of each value that `seen` returns. Shape (n,)."""
        if self._features is not None:
            return np.repeat(self._measurement.measured, self._features.n_per_output)
        return self._output_of[: int(np.ceil(self._part * self._output_of.size))]

    def unexplained(self, residuals: FloatArray) -> float:
        """Return the mean squared error in the window by the variance measured, of the worst output. [1].

        Args:
            residuals: Of one row, all of them. Shape (m,). [first output's unit]
        """
        if self._features is not None:
            return FEATURE_WEIGHT * self._features.unexplained(self._simulated(residuals))
        seen = self.seen(residuals)
        shares = [
            float(np.mean(seen[of[: seen.size]] ** 2)) / variance
            for of, variance in zip(self._is_of, self._variance, strict=True)
            if variance > 0.0 and of[: seen.size].any()
        ]
        return max(shares, default=0.0)

    def switches(self, residuals: FloatArray) -> bool:
        """Return whether some output's kinks lie at different times in different rows.

        Args:
            residuals: Of some rows, all of them. Shape (n, m). [first output's unit]
        """
        simulated = self._simulated(residuals)
        return any(switches(simulated[:, of]) for of in self._is_of)

    def _simulated(self, residuals: FloatArray) -> FloatArray:
        """Return simulated outputs at the samples, scaled, of residuals of that shape."""
        return np.asarray(self._measurement.scaled_differences(residuals) + self._measured)

    def shorten(self, *, to_features: bool = False) -> None:
        """Take the shortest window, or features of all trajectories first, where there are samples enough."""
        is_enough = self._is_of.sum(axis=1).min() >= LEAST_BLOCK * N_BLOCKS
        if to_features and is_enough:
            self._features = TrajectoryFeatures(self._measured, self._is_of)
        # Also where features come first: windows follow them.
        self._part = SHORTEST

    def double(self) -> None:
        """Double the window; after features, take the shortest one."""
        if self._features is None:
            self._part = min(2.0 * self._part, 1.0)
        self._features = None
