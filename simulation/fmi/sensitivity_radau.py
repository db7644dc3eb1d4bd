"""Linear differential equations dS/dt = J(t) S + F(t) by the Radau IIA method of fifth order, compiled.

E. Hairer and G. Wanner, Solving Ordinary Differential Equations II, 2nd ed., Springer 1996, sections IV.5 and
IV.8.
The equations are linear, so each step is one linear system and no iteration.
"""

from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.call import compiled

_ROOT6: Final = 6.0**0.5
# Collocation points, as shares of a step.
NODES: Final = ((4.0 - _ROOT6) / 10.0, (4.0 + _ROOT6) / 10.0, 1.0)
_MATRIX: Final = np.array(
    [
        [(88.0 - 7.0 * _ROOT6) / 360.0, (296.0 - 169.0 * _ROOT6) / 1800.0, (-2.0 + 3.0 * _ROOT6) / 225.0],
        [(296.0 + 169.0 * _ROOT6) / 1800.0, (88.0 + 7.0 * _ROOT6) / 360.0, (-2.0 - 3.0 * _ROOT6) / 225.0],
        [(16.0 - _ROOT6) / 36.0, (16.0 + _ROOT6) / 36.0, 1.0 / 9.0],
    ]
)
# Inverse of the real eigenvalue of the inverse matrix, (8.15), and the weights of the error estimate, (8.19).
_GAMMA: Final = 1.0 / (3.0 + 3.0 ** (2.0 / 3.0) - 3.0 ** (1.0 / 3.0))
_WEIGHTS: Final = (
    _GAMMA / 3.0 * (-13.0 - 7.0 * _ROOT6),
    _GAMMA / 3.0 * (-13.0 + 7.0 * _ROOT6),
    -_GAMMA / 3.0,
)


@compiled
def _eliminate(matrix: FloatArray, right: FloatArray) -> None:
    """Solve matrix @ solution = right in place, by Gaussian elimination with row pivots."""
    n = matrix.shape[0]
    for k in range(n):
        pivot = k + np.argmax(np.abs(matrix[k:, k]))
        if pivot != k:
            for j in range(k, n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            for j in range(right.shape[1]):
                right[k, j], right[pivot, j] = right[pivot, j], right[k, j]
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                for j in range(right.shape[1]):
                    right[i, j] -= factor * right[k, j]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            factor = matrix[i, j]
            if factor != 0.0:
                for c in range(right.shape[1]):
                    right[i, c] -= factor * right[j, c]
        for c in range(right.shape[1]):
            right[i, c] /= matrix[i, i]


@compiled
def radau_step(
    step: float, jacobians: FloatArray, forcings: FloatArray, s: FloatArray, weights: FloatArray, rtol: float
) -> tuple[Any, float]:
    """Take one step, to be accepted where the error is at most 1.

    Args:
        step: Its length. [s]
        jacobians: J at the three nodes and at the start. Shape (4, n, n). [1/s]
        forcings: F at the three nodes and at the start. Shape (4, n, p).
        s: S at the start. Shape (n, p).
        weights: Error of each entry of S that counts as nothing, on top of rtol of it. Shape (n, p).
        rtol: Relative tolerance.

    Returns:
        S at the end, shape (n, p), and the greatest estimated error, in units of what is tolerated.
    """
    n, p = s.shape
    matrix, right = np.empty((3 * n, 3 * n)), np.empty((3 * n, p))
    slopes = np.empty((4, n, p))
    for node in range(4):
        for i in range(n):
            for c in range(p):
                slope = forcings[node, i, c]
                for j in range(n):
                    slope += jacobians[node, i, j] * s[j, c]
                slopes[node, i, c] = slope
    for row in range(3):
        for i in range(n):
            for column in range(3):
                for j in range(n):
                    unit = 1.0 if row == column and i == j else 0.0
                    matrix[row * n + i, column * n + j] = (
                        unit - step * _MATRIX[row, column] * jacobians[column, i, j]
                    )
            for c in range(p):
                right[row * n + i, c] = step * (
                    _MATRIX[row, 0] * slopes[0, i, c]
                    + _MATRIX[row, 1] * slopes[1, i, c]
                    + _MATRIX[row, 2] * slopes[2, i, c]
                )
    _eliminate(matrix, right)
    small, error = np.empty((n, n)), np.empty((n, p))
    for i in range(n):
        for j in range(n):
            small[i, j] = (1.0 if i == j else 0.0) - step * _GAMMA * jacobians[3, i, j]
        for c in range(p):
            error[i, c] = (
                step * _GAMMA * slopes[3, i, c]
                + _WEIGHTS[0] * right[i, c]
                + _WEIGHTS[1] * right[n + i, c]
                + _WEIGHTS[2] * right[2 * n + i, c]
            )
    _eliminate(small, error)
    after, worst = np.empty((n, p)), 0.0
    for i in range(n):
        for c in range(p):
            after[i, c] = s[i, c] + right[2 * n + i, c]
            size = abs(error[i, c]) / (weights[i, c] + rtol * max(abs(s[i, c]), abs(after[i, c])))
            worst = max(worst, size if np.isfinite(size) else np.inf)
    return after, worst
