"""Slopes of residuals at a point, by central differences of the model."""

import numpy as np

from simulation.arrays import BoolArray, FloatArray


def difference_rows(u: FloatArray, step: float) -> FloatArray:
    """Return a point, then one row per parameter moved up, then one per parameter moved down.

    Args:
        u: The point in the unit cube. Shape (p,). [1]
        step: How far; a bound cuts it. [1]

    Returns:
        Shape (2 p + 1, p). [1]
    """
    # At a bound the difference is one-sided, as nothing says that the model answers beyond it.
    ahead, behind = np.minimum(u + step, 1.0), np.maximum(u - step, 0.0)
    is_moved = np.eye(len(u), dtype=np.bool_)
    return np.concatenate([u[None], np.where(is_moved, ahead, u), np.where(is_moved, behind, u)])


def difference_slopes(u: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return a row of the residuals' slopes per parameter, 0 where both sides fail. Shape (p, m).

    Where one side fails, the point itself takes its place.

    Args:
        u: The points of `difference_rows`. Shape (2 p + 1, p). [1]
        residuals: The model there, not finite where it failed. Shape (2 p + 1, m). [unit]
    """
    p = u.shape[1]
    ends = []
    for side in (slice(1, p + 1), slice(p + 1, None)):
        # One failed side leaves a one-sided difference, which is less exact but says more than none.
        is_good: BoolArray = np.all(np.isfinite(residuals[side]), axis=1)
        there = np.where(is_good, np.diag(u[side]), u[0])
        ends.append((there, np.where(is_good[:, None], residuals[side], residuals[0])))
    (ahead, above), (behind, below) = ends
    # Where both sides failed the slope becomes 0 / 1, not 0 / 0.
    width = np.where(ahead > behind, ahead - behind, 1.0)
    return (above - below) / width[:, None]
