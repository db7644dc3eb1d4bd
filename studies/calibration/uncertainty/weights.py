"""Samples whose members count differently: effective size, quantiles, means."""

import numpy as np

from simulation.arrays import FloatArray


def normalized(log_weights: FloatArray) -> FloatArray:
    """Return weights that sum to 1; all the same where none is finite. Shape (n,). [1].

    Args:
        log_weights: Their logarithms, but for a constant. Shape (n,). [1]
    """
    finite = np.isfinite(log_weights)
    if not finite.any():
        return np.full(len(log_weights), 1.0 / max(len(log_weights), 1))
    # The largest becomes 1: nothing overflows, and the sum cannot vanish.
    weights = np.exp(np.where(finite, log_weights, -np.inf) - log_weights[finite].max())
    total: FloatArray = weights / weights.sum()
    return total


def effective_size(weights: FloatArray) -> float:
    """Return how many members of equal weight a sample is worth (Kish).

    Args:
        weights: Sum 1. Shape (n,). [1]
    """
    return 1.0 / float(np.sum(weights**2)) if len(weights) else 0.0


def quantiles(values: FloatArray, weights: FloatArray, shares: FloatArray) -> FloatArray:
    """Return weighted quantiles, straight between the middles of the members' weights.

    Args:
        values: Shape (n, d).
        weights: Sum 1. Shape (n,). [1]
        shares: Between 0 and 1. Shape (q,). [1]

    Returns:
        Shape (q, d).
    """
    order = np.argsort(values, axis=0)
    ranked, sorted_weights = np.take_along_axis(values, order, axis=0), weights[order]
    # Hazen's rule for weights: a member stands at the middle of its own, so both ends are treated alike.
    middles = np.cumsum(sorted_weights, axis=0) - 0.5 * sorted_weights
    columns = [np.interp(shares, middles[:, d], ranked[:, d]) for d in range(values.shape[1])]
    return np.stack(columns, axis=1)
