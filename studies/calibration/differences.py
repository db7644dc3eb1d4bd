"""Slopes of residuals at a point, by differences of the model."""

import numpy as np

from simulation.arrays import FloatArray


def difference_rows(u: FloatArray, step: float) -> FloatArray:
    """Return a point, then two more rows per parameter: all first ones, then all second ones.

    They lie on both sides of the point; where a bound is nearer than half a step, both on the other side.

    Args:
        u: The point in the unit cube. Shape (p,). [1]
        step: How far; a bound cuts it. [1]

    Returns:
        Shape (2 p + 1, p). [1]
    """
    # Nothing says that the model answers beyond a bound.
    ahead, behind = np.minimum(u + step, 1.0), np.maximum(u - step, 0.0)
    ahead = np.where(ahead - u < 0.5 * step, u - 2.0 * step, ahead)
    behind = np.where(u - behind < 0.5 * step, u + 2.0 * step, behind)
    is_moved = np.eye(len(u), dtype=np.bool_)
    return np.concatenate([u[None], np.where(is_moved, ahead, u), np.where(is_moved, behind, u)])


def difference_slopes(u: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return a row of the residuals' slopes per parameter, 0 where both rows fail. Shape (p, m).

    They are those of the parabola through the three rows, of which no bend is taken for a slope however
    uneven the steps are. Where one row fails, it is the line through the other two.

    Args:
        u: The points of `difference_rows`. Shape (2 p + 1, p). [1]
        residuals: The model there, not finite where it failed. Shape (2 p + 1, m). [unit]
    """
    p = u.shape[1]
    sides = slice(1, p + 1), slice(p + 1, None)
    first, second = (np.diag(u[side]) - u[0] for side in sides)
    is_good = [np.all(np.isfinite(residuals[side]), axis=1) for side in sides]
    # Weights of the two changes: Lagrange's formula, or of a line where the other row fails.
    both = is_good[0] & is_good[1]
    of_first = np.where(both, second / (first * (second - first)), is_good[0] / first)
    of_second = np.where(both, first / (second * (first - second)), is_good[1] / second)
    changes = [
        np.where(good[:, None], residuals[side] - residuals[0], 0.0)
        for good, side in zip(is_good, sides, strict=True)
    ]
    return np.asarray(of_first[:, None] * changes[0] + of_second[:, None] * changes[1])
