"""Rows of a model's answers: put together, and chosen for what they teach a surrogate of an optimum."""

import numpy as np

from simulation.arrays import FloatArray, IntArray
from studies.calibration.problem import Evaluation

MOST_KNOWN, MOST_ROWS = 250, 400
"""Stored rows that the process is fitted to, and rows in all; its cost grows with their third power."""

N_BEST = 50
"""So many of the most probable rows are among them, known or asked, however many were asked."""

SAME_ROW = 1e-3
"""Rows nearer to a better one than this in the unit cube add nothing."""


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
    if len(u) - n_known > MOST_ROWS - N_BEST:
        is_best[np.argsort(-log_density, kind="stable")[:N_BEST]] = True
    # lexsort sorts by its last key first: asked and best rows, then stored ones, each by density.
    for row in np.lexsort((-log_density, is_known & ~is_best)):
        # Stored rows come last, so their own limit may end the loop.
        if len(kept) == MOST_ROWS or n_best == MOST_KNOWN:
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
    return Evaluation(
        u=np.concatenate([part.u for part in parts]),
        theta=np.concatenate([part.theta for part in parts]),
        y=np.concatenate([part.y for part in parts]),
        residuals=np.concatenate([part.residuals for part in parts]),
        mse=np.concatenate([part.mse for part in parts]),
        objective=np.concatenate([part.objective for part in parts]),
        failures=tuple(failure for part in parts for failure in part.failures),
    )
