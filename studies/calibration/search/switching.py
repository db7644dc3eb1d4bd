"""Whether a model switches at times that depend on its parameters, as a thermostat does.

Where an input jumps, the trajectories of all parameter sets have a kink at the same time. Where the model
itself switches, kinks move with the parameters, and the error jumps where one more of them fits into the
window. Functions that are smooth in the parameters, as the surrogate's are, say nothing of what lies beyond.
"""

import numpy as np

from simulation.arrays import FloatArray

# A kink is a second difference so many times those so many samples before and after it, where smooth motion
# has similar ones, and at least this part of the trajectory's standard deviation, so that rounding at rest is
# none. By hand.
SHARP, KINK_APART, VISIBLE = 10.0, 3, 1e-3
# Trajectories with fewer kinks have none. By hand.
LEAST_KINKS = 2
# Another trajectory has the same kink where its own second difference, there or one sample beside, is at
# least this part of it: kinks that inputs make differ in size. By hand.
SAME_KINK = 0.2
# Share of kinks that another trajectory lacks, median over pairs, from which a model switches: 0.00 to 0.09
# where inputs alone drive it, 0.23 to 0.49 in thermostats
# (docs/notes/adaptive-search.md, Models that switch).
MOVED = 0.15


def switches(trajectories: FloatArray) -> bool:
    """Return whether the kinks of trajectories lie at different times.

    Args:
        trajectories: One output of some parameter sets at the times of its samples. Shape (n, t). [unit]
    """
    n, n_times = trajectories.shape
    apart = KINK_APART
    if n < 2 or n_times <= 2 * apart + 2:
        return False
    bends = np.abs(np.diff(trajectories, 2, axis=1))
    is_kink = np.zeros(bends.shape, dtype=np.bool_)
    # Smooth motion bends alike over some samples; a kink stands out from both sides.
    beside = np.maximum(bends[:, : -2 * apart], bends[:, 2 * apart :])
    least = np.maximum(SHARP * beside, VISIBLE * trajectories.std(axis=1, keepdims=True))
    is_kink[:, apart:-apart] = bends[:, apart:-apart] > least
    around = np.pad(bends, ((0, 0), (1, 1)))
    # Between samples the same kink may fall one earlier or later.
    near = np.maximum(np.maximum(around[:, :-2], around[:, 1:-1]), around[:, 2:])
    kinked = np.flatnonzero(is_kink.sum(axis=1) >= LEAST_KINKS)
    # As on an oscillator (docs/notes/adaptive-search.md, Models that switch, later in version 0.3).
    if 2 * len(kinked) < n:
        return False
    # Which part of the kinks of one trajectory another one lacks.
    shares = [
        np.mean(near[other, is_kink[one]] < SAME_KINK * bends[one, is_kink[one]])
        for one in kinked
        for other in range(n)
        if other != one
    ]
    return bool(np.median(shares) >= MOVED)
