"""What each surrogate of a mean counts, by rows that none was trained on."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from pelsvae.standardize import Array
from pelsvae.surrogate import Surrogate

_ROWS = 64  # predicted at once: long outputs of many rows fill no memory
_VALUES = 4_000_000  # errors of a part that are weighed; of longer outputs every k-th time is
_LEAST = 0.05  # share below which a part is left out: each one takes the time of a prediction
_STEPS = 30  # of reweighted least squares; the last ten change the error by less than 0.1 %


def mean_shares(parts: Sequence[Surrogate], theta: Array, y: Array, output_scales: Array) -> Array:
    """Find the shares of a mean whose mean absolute error is least over rows that no part was trained on.

    Args:
        parts: The surrogates.
        theta: Parameters of the rows. Shape (n, p). [per parameter]
        y: Their trajectories. Shape (n, t, k). [output's unit]
        output_scales: What makes errors of different units comparable. Shape (k,).

    Returns:
        Shares with sum 1; those that hardly count are 0. Shape (m,). [1]
    """
    step = -(-y.size // _VALUES)
    left = np.stack([_left(one, theta, y, output_scales, step) for one in parts])  # (m, values)
    used = np.arange(len(parts))
    while True:
        share = _least_absolute(left[used])
        if (share >= _LEAST).all():
            found = np.zeros(len(parts))
            found[used] = share
            return found
        used = used[share >= _LEAST]


def _left(part: Surrogate, theta: Array, y: Array, output_scales: Array, step: int) -> Array:
    """Return the errors of a surrogate at every `step`-th time, as one row. [first output's unit]."""
    chunks = []
    for start in range(0, len(theta), _ROWS):
        rows = slice(start, start + _ROWS)
        chunks.append(((part.predict(theta[rows]) - y[rows])[:, ::step] * output_scales).ravel())
    return np.concatenate(chunks)


def _least_absolute(left: Array) -> Array:
    """Return shares (m,) of least mean absolute error, of errors (m, values).

    Least squares, weighed by the inverse of each error, end where absolute errors are least. One part alone
    counts if no mean errs less.
    """
    m = len(left)
    size = float(np.abs(left).mean())
    if m == 1 or size == 0.0:
        alone: Array = np.eye(m)[0]
        return alone
    share = np.full(m, 1.0 / m)
    for _ in range(_STEPS):
        weight = 1.0 / np.maximum(np.abs(share @ left), 1e-3 * size)
        share = _least_squares((left * weight) @ left.T)
    candidates = [share, *np.eye(m)]
    return candidates[int(np.argmin([np.abs(one @ left).mean() for one in candidates]))]


def _least_squares(square: Array) -> Array:
    """Return shares (m,), not negative and with sum 1, that make share' square share least."""
    m = len(square)
    # A weight of the sum makes the problem homogeneous, a little of the diagonal keeps it regular.
    factor = np.linalg.cholesky(square * m / np.trace(square) + np.ones((m, m)) + 1e-9 * np.eye(m))
    share, _ = nnls(factor.T, np.linalg.solve(factor, np.ones(m)))
    normal: Array = share / share.sum()
    return normal
