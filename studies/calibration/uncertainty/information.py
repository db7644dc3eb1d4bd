"""What a measurement that is not yet taken would show: expected half widths of the intervals.

Near a point, residuals are linear: with their slopes J, in noise, a measurement adds the information J' J to
that of the present one, of the bounds (12, see identifiability.py) and of the priors. Parameters that a new
measurement has of its own, as a temperature at its start, are unknown within their bounds, and what they may
explain is taken off (Schur complement). The inverse of the sum is the covariance that is expected.
"""

from typing import Literal

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.prior import Prior
from studies.calibration.uncertainty.assess import Z
from studies.calibration.uncertainty.identifiability import BOX_PRECISION

Criterion = Literal["half-widths", "A", "D"]


def information(slopes: FloatArray, is_own: BoolArray) -> FloatArray:
    """Return what a measurement says of the parameters of all. Shape (p, p). [1].

    Args:
        slopes: Of its samples, in noise. Shape (m, p). [1]
        is_own: Which parameters it has a value of its own of. Shape (p,).
    """
    shared, own = np.where(is_own, 0.0, slopes), slopes[:, is_own]
    both, alone = shared.T @ own, own.T @ own + BOX_PRECISION * np.eye(own.shape[1])
    found: FloatArray = shared.T @ shared - both @ np.linalg.solve(alone, both.T)
    return found


def covariance(known: FloatArray, prior: Prior | None) -> FloatArray:
    """Return what is left open of parameters by information (p, p), bounds and priors. Shape (p, p). [1]."""
    before = BOX_PRECISION + (0.0 if prior is None else prior.width**-2.0)
    return np.asarray(np.linalg.inv(known + before * np.eye(len(known))), dtype=np.float64)


def half_widths(open_: FloatArray) -> FloatArray:
    """Return half the 90 % intervals of a covariance (p, p), as shares of the ranges. Shape (p,). [1]."""
    return np.asarray(Z * np.sqrt(np.diag(open_)))


def merit(open_: FloatArray, criterion: Criterion) -> float:
    """Return what a criterion says of a covariance (p, p): the less, the better.

    Args:
        open_: The covariance. [1]
        criterion: The mean half width, the trace (A-optimal) or the logarithm of the determinant (D-optimal).
    """
    if criterion == "half-widths":
        return float(half_widths(open_).mean())
    return float(np.trace(open_)) if criterion == "A" else float(np.linalg.slogdet(open_)[1])
