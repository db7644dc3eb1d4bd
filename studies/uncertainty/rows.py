"""Rows of a model's answers: put together, and chosen for what they tell a surrogate of an optimum."""

import numpy as np

from simulation.arrays import FloatArray, IntArray
from studies.calibration.problem import Evaluation

MOST_ROWS = 250
"""Rows that the process is fitted to, the best ones; its cost grows with their third power."""

SAME_ROW = 1e-3
"""Rows nearer to a better one than this in the unit cube tell nothing new."""


def telling_rows(u: FloatArray, log_density: FloatArray) -> IntArray:
    """Return the most probable rows without those that repeat a better one. Shape (r,).

    Args:
        u: Points. Shape (n, p). [1]
        log_density: Minus infinity where a simulation failed. Shape (n,). [1]
    """
    kept: list[int] = []
    for row in np.argsort(-log_density, kind="stable"):
        if len(kept) == MOST_ROWS or not np.isfinite(log_density[row]):
            break
        if not kept or float(np.abs(u[kept] - u[row]).max(axis=1).min()) > SAME_ROW:
            kept.append(int(row))
    return np.array(kept, dtype=np.int64)


def joined(parts: list[Evaluation]) -> Evaluation:
    """Return evaluations as one."""
    return Evaluation(
        u=np.concatenate([part.u for part in parts]),
        theta=np.concatenate([part.theta for part in parts]),
        y=np.concatenate([part.y for part in parts]),
        residuals=np.concatenate([part.residuals for part in parts]),
        mse=np.concatenate([part.mse for part in parts]),
        objective=np.concatenate([part.objective for part in parts]),
        failures=tuple(failure for part in parts for failure in part.failures),
    )
