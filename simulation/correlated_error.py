"""Errors of a sensor that resemble each other: differences become independent, and back.

With the correlation time tau, errors of samples dt apart have the correlation rho = exp(-dt / tau), as in a
first-order autoregressive process that is sampled at any times (Ornstein-Uhlenbeck). The innovations

    e_1 = d_1,    e_i = (d_i - rho_i d_{i-1}) / sqrt(1 - rho_i²)

of the differences d are then independent, each with the deviation of a single error. The sum of their squares
is d' R^-1 d with the correlation matrix R: minus twice the logarithm of the likelihood, times its variance.
"""

import numpy as np

from simulation.arrays import FloatArray


def correlations(time: FloatArray, lasts_s: float) -> FloatArray:
    """Return the correlation of each sample's error with the one before, 0 of the first. Shape (m,). [1].

    Args:
        time: Sample times, rising. Shape (m,). [s]
        lasts_s: Correlation time. [s]
    """
    return np.concatenate([[0.0], np.exp(-np.diff(time) / lasts_s)])


def whitened(differences: FloatArray, rho: FloatArray) -> FloatArray:
    """Return the innovations of differences. Shape (..., m) as they have. [output's unit].

    Args:
        differences: In the order of time. Shape (..., m). [output's unit]
        rho: Correlation of each with the one before. Shape (m,). [1]
    """
    found = np.array(differences, dtype=np.float64)
    found[..., 1:] -= rho[1:] * differences[..., :-1]
    return found / np.sqrt(1.0 - rho**2)


def coloured(innovations: FloatArray, rho: FloatArray) -> FloatArray:
    """Return the differences that have these innovations. Shapes as in `whitened`. [output's unit]."""
    found = innovations * np.sqrt(1.0 - rho**2)
    for i in range(1, found.shape[-1]):
        found[..., i] += rho[i] * found[..., i - 1]
    return found
