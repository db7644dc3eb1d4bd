"""Which stored rows a calibration starts from (warm start), and whether they fill the bounds."""

import numpy as np

from simulation.arrays import FloatArray, IntArray

N_BEST, N_FAR = 200, 50
"""The best rows say where the optimum is, some far from all others where it is not. The surrogate's cost
grows with the third power of their number."""

SAME_ROW = 1e-3
"""Rows nearer to a better one than this in the unit cube are left out."""

APART = 0.1
"""Rows so far from each other, in one parameter at least, count as a design."""


def best_and_far(u: FloatArray, worth: FloatArray, n_best: int = N_BEST, n_far: int = N_FAR) -> IntArray:
    """Return the most informative rows: the best first, then those farthest from all before them. Shape (r,).

    Args:
        u: Points. Shape (n, p). [1]
        worth: How good they are; minus infinity where a simulation failed. Shape (n,).
        n_best: How many of the best.
        n_far: How many beside them.
    """
    left = np.flatnonzero(np.isfinite(worth))
    left = left[np.argsort(-worth[left], kind="stable")]
    points, kept = u[left], list[int]()
    distance = np.full(len(left), np.inf)
    while len(kept) < n_best + n_far and (distance > SAME_ROW).any():
        is_new = distance > SAME_ROW
        # argmax of truth values is the first true one: of those left, the best row.
        place = int(np.argmax(is_new if len(kept) < n_best else distance))
        kept.append(int(left[place]))
        # Farthest-point order needs distances to the last one
        # alone (Gonzalez 1985, doi:10.1016/0304-3975(85)90224-5).
        distance = np.minimum(distance, np.abs(points - points[place]).max(axis=1))
    return np.array(kept, dtype=np.int64)


def n_apart(u: FloatArray) -> int:
    """Return how many of points (n, p) lie apart from each other, taken one after the other."""
    kept = np.empty((0, u.shape[1]))
    for point in u:
        if (np.abs(kept - point).max(axis=1) > APART).all():
            kept = np.vstack([kept, point])
    return len(kept)
