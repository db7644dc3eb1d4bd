"""What each surrogate of a mean counts, by rows that none was trained on."""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from pelsvae.standardize import Array
from pelsvae.surrogate import Surrogate

_ROWS = 64  # predicted at once while shares are found: long outputs of many rows fill no memory
_LEAST = 0.05  # share below which a part is left out: each one takes the time of a prediction


def mean_shares(parts: Sequence[Surrogate], theta: Array, y: Array, output_scales: Array) -> Array:
    """Find the shares of a mean whose squared error is least over rows that no part was trained on.

    Args:
        parts: The surrogates.
        theta: Parameters of the rows. Shape (n, p). [per parameter]
        y: Their trajectories. Shape (n, t, k). [output's unit]
        output_scales: What makes errors of different units comparable. Shape (k,).

    Returns:
        Shares with sum 1; those that hardly count are 0. Shape (m,). [1]
    """
    square = np.zeros((len(parts), len(parts)))  # sums of products of two parts' errors
    for start in range(0, len(theta), _ROWS):
        rows = slice(start, start + _ROWS)
        left = np.stack([(one.predict(theta[rows]) - y[rows]) * output_scales for one in parts])
        left = left.reshape(len(parts), -1)
        square += left @ left.T
    used = np.arange(len(parts))
    while True:
        share = _shares(square[np.ix_(used, used)])
        if (share >= _LEAST).all():
            found = np.zeros(len(parts))
            found[used] = share
            return found
        used = used[share >= _LEAST]


def _shares(square: Array) -> Array:
    """Return shares (m,), not negative and with sum 1, that make share' square share least."""
    m = len(square)
    size = np.trace(square) / m
    if size <= 0.0:
        return np.full(m, 1.0 / m)
    # A weight of the sum makes the problem homogeneous, a little of the diagonal keeps it regular.
    factor = np.linalg.cholesky(square / size + np.ones((m, m)) + 1e-9 * np.eye(m))
    share, _ = nnls(factor.T, np.linalg.solve(factor, np.ones(m)))
    normal: Array = share / share.sum()
    return normal
