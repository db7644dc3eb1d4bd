"""Rows of a model's answers: put together, chosen for what they teach, and where others will succeed."""

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from studies.calibration.problem import Evaluation

MOST_KNOWN, MOST_IN_PROCESS = 250, 400
"""Stored rows that the process is fitted to, and rows in all; its cost grows with their third power."""

N_MOST_PROBABLE = 50
"""So many of the most probable rows are among them, known or asked, however many were asked."""

SAME_ROW = 1e-3
"""Rows nearer to a better one than this in the unit cube add nothing."""

# At an edge half to two thirds of the rows fail, before 94 to 96 of 96 (docs/notes/uncertainty.md).
N_NEAREST = 5
"""Rows that say whether a place between them succeeds."""

LEAST_SUCCESS = 1e-3
"""Share of success where all of them failed: the model may be otherwise in between."""


def informative_rows(u: FloatArray, log_density: FloatArray, n_known: int | None = None) -> IntArray:
    """Return the rows that say most, the most probable first, none that repeats a better one. Shape (r,).

    Of stored rows these are the most probable ones. Rows that a sampler asked come before them: one that
    turned out improbable is where the surrogate was wrong, and forgotten it would be asked again. Only where
    these leave no room, the best rows come first.

    Args:
        u: Points, those first that were known before. Shape (n, p). [1]
        log_density: Minus infinity where a simulation failed. Shape (n,). [1]
        n_known: How many were known before, None for all.
    """
    n_known = len(u) if n_known is None else n_known
    is_known = np.arange(len(u)) < n_known
    kept: list[int] = []
    n_best = 0
    is_best = np.zeros(len(u), dtype=np.bool_)
    # Only where asked rows fill the room: else stored rows follow anyway, the best ones first.
    if len(u) - n_known > MOST_IN_PROCESS - N_MOST_PROBABLE:
        is_best[np.argsort(-log_density, kind="stable")[:N_MOST_PROBABLE]] = True
    # lexsort sorts by its last key first: asked and best rows, then stored ones, each by density.
    for row in np.lexsort((-log_density, is_known & ~is_best)):
        # Stored rows come last, so their own limit may end the loop.
        if len(kept) == MOST_IN_PROCESS or n_best == MOST_KNOWN:
            break
        if not np.isfinite(log_density[row]):
            continue
        # Two rows at one place would also make the matrix of covariances singular.
        if not kept or float(np.abs(u[kept] - u[row]).max(axis=1).min()) > SAME_ROW:
            kept.append(int(row))
            n_best += bool(is_known[row])
    rows = np.array(kept, dtype=np.int64)
    # Callers take the first row for the best one.
    return rows[np.argsort(-log_density[rows], kind="stable")]


def joined(parts: list[Evaluation]) -> Evaluation:
    """Return evaluations as one."""
    arrays = ("u", "theta", "y", "residuals", "mse", "objective")
    return Evaluation(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in arrays},
        failures=tuple(failure for part in parts for failure in part.failures),
    )


def log_success(u: FloatArray, known: FloatArray, failed: BoolArray, precision: FloatArray) -> FloatArray:
    """Return the logarithm of the share of the nearest rows that succeeded, 0 where none has ever failed.

    Args:
        u: Points. Shape (m, p). [1]
        known: Points that were simulated. Shape (n, p). [1]
        failed: Which of them failed. Shape (n,).
        precision: What is near: of the density around its best point. Shape (p, p). [1]

    Returns:
        Shape (m,). [1]
    """
    if not failed.any():
        return np.zeros(len(u))
    # In the density's own widths: in the unit cube a narrow one's edge is not seen (60 to 83 of 96 fail).
    root = np.linalg.cholesky(precision)
    known, asked = known @ root, np.clip(u, 0.0, 1.0) @ root
    # But for what all distances from a point have in common.
    distances = np.sum(known**2, axis=1) - 2.0 * asked @ known.T
    # Stable: rows at equal distance keep their order, so a seed gives the same sample on every machine.
    nearest = np.argsort(distances, axis=1, kind="stable")[:, :N_NEAREST]
    share = 1.0 - failed[nearest].mean(axis=1)
    value: FloatArray = np.log(np.maximum(share, LEAST_SUCCESS))
    return value
