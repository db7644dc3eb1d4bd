"""Whether a model switches at times that depend on its parameters, as a thermostat does.

Where an input jumps, the trajectories of all parameter sets have a kink at the same time. Where the model
itself switches, kinks move with the parameters, and the error jumps where one more of them fits into the
window. Functions that are smooth in the parameters, as the surrogate's are, say nothing of what lies beyond.
"""

import numpy as np

from simulation.arrays import BoolArray, FloatArray

# A kink: a second difference so many times those so many samples before and after it, where smooth motion has
# similar ones, and at least this part of the trajectory's standard deviation, so that rounding at rest is
# none. Trajectories with fewer kinks have none.
SHARP, APART, VISIBLE, LEAST_KINKS = 10.0, 3, 1e-3, 2
# Another trajectory has the same kink where its own second difference, there or one sample beside, is at
# least this part of it: kinks that inputs make differ in size.
SAME_KINK = 0.2
# Share of kinks that another trajectory lacks, median over pairs, from which a model switches. In cases that
# only inputs drive it is 0.00 to 0.09, in thermostats 0.23 to 0.49 (docs/notes/adaptive-search.md).
MOVED = 0.15
# Trajectories that are compared, of parameter sets that lie apart.
N_COMPARED = 8


def switches(trajectories: FloatArray) -> bool:
    """Tell whether the kinks of trajectories lie at different times.

    Args:
        trajectories: One output of some parameter sets at the times of its samples. Shape (n, t). [unit]
    """
    n, n_times = trajectories.shape
    if n < 2 or n_times <= 2 * APART + 2:
        return False
    bends = np.abs(np.diff(trajectories, 2, axis=1))
    is_kink = np.zeros(bends.shape, dtype=np.bool_)
    beside = np.maximum(bends[:, : -2 * APART], bends[:, 2 * APART :])
    least = np.maximum(SHARP * beside, VISIBLE * trajectories.std(axis=1, keepdims=True))
    is_kink[:, APART:-APART] = bends[:, APART:-APART] > least
    around = np.pad(bends, ((0, 0), (1, 1)))
    near = np.maximum(np.maximum(around[:, :-2], around[:, 1:-1]), around[:, 2:])
    kinked = np.flatnonzero(is_kink.sum(axis=1) >= LEAST_KINKS)
    if 2 * len(kinked) < n:
        return False
    shares = [
        _share_lacked(near[other], bends[one], is_kink[one])
        for one in kinked
        for other in range(n)
        if other != one
    ]
    return bool(np.median(shares) >= MOVED)


def _share_lacked(near: FloatArray, bends: FloatArray, is_kink: BoolArray) -> float:
    """Return which part of the kinks of one trajectory another one lacks. [1]."""
    return float(np.mean(near[is_kink] < SAME_KINK * bends[is_kink]))
