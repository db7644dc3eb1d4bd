"""What trajectories are without their phase: means, deviations and roughness of blocks of time.

Where a model switches, the error jumps with the number of switchings that fit into the window, and saw teeth
that are out of phase are as bad as none. The mean of an output over some hours, its deviation from it and the
size of its steps vary smoothly with the parameters: they show amplitude and period before the phase is known.
"""

import numpy as np

from simulation.arrays import BoolArray, FloatArray

# Blocks of time of which features are taken. By hand.
N_BLOCKS = 4

# Kinds of features, see `TrajectoryFeatures`.
N_KINDS = 3


class TrajectoryFeatures:
    """The features of all outputs, compared with those of the measurement."""

    def __init__(self, measured: FloatArray, is_of: BoolArray) -> None:
        """Begin with the measurement.

        Args:
            measured: Samples of all outputs, scaled, some for each block. Shape (m,). [first output's unit]
            is_of: Which of them belong to each output. Shape (k, m).
        """
        self._is_of = is_of
        self._means = [float(measured[of].mean()) for of in is_of]
        self._sizes = [float(measured[of].std()) or 1.0 for of in is_of]
        self._unit = float(np.mean(self._sizes))
        self._scale: FloatArray = np.ones((len(is_of), N_BLOCKS, N_KINDS))
        self._measured = self._of(measured)
        # Deviation and roughness count relative to what was measured, means relative to its deviation.
        rms = np.sqrt(np.mean(self._measured**2, axis=1, keepdims=True))
        rms[..., 0] = 1.0
        # A measurement that is a straight line has no deviation to divide by.
        self._scale = self._scale / np.maximum(rms, np.sqrt(np.finfo(float).eps))
        self._measured = self._of(measured)

    @property
    def n_per_output(self) -> int:
        """Features of one output; those of the first output come first."""
        return N_BLOCKS * N_KINDS

    def differences(self, simulated: FloatArray) -> FloatArray:
        """Return the features less the measured ones. Shape (..., f). [first output's unit].

        Args:
            simulated: Samples of all outputs, scaled. Shape (..., m). [first output's unit]
        """
        found = self._of(simulated) - self._measured
        return self._unit * found.reshape(*simulated.shape[:-1], -1)

    def unexplained(self, simulated: FloatArray) -> float:
        """Return the greatest share of a kind of feature that a row (m,) leaves unexplained. [1]."""
        return float(np.mean((self._of(simulated) - self._measured) ** 2, axis=1).max())

    def _of(self, samples: FloatArray) -> FloatArray:
        """Return scaled features of samples (..., m). Shape (..., k, blocks, kinds). [1]."""
        by_output = []
        for of, mean, size in zip(self._is_of, self._means, self._sizes, strict=True):
            blocks = np.array_split((samples[..., of] - mean) / size, N_BLOCKS, axis=-1)
            by_output.append(np.stack([_kinds(block) for block in blocks], axis=-2))
        return np.stack(by_output, axis=-3) * self._scale


def _kinds(block: FloatArray) -> FloatArray:
    """Return mean, deviation from a straight line, and steps of it, of (..., t). Shape (..., 3). [1]."""
    mean = block.mean(axis=-1)
    line = np.linspace(-1.0, 1.0, block.shape[-1])
    line = line / np.sqrt(line @ line)
    left = block - mean[..., None]
    # With its slope, a slow drift would pass for amplitude.
    left = left - (left @ line)[..., None] * line
    return np.stack(
        [mean, np.sqrt(np.mean(left**2, axis=-1)), np.sqrt(np.mean(np.diff(left, axis=-1) ** 2, axis=-1))],
        axis=-1,
    )
