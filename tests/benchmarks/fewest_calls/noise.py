"""Noise that lasts."""

import numpy as np
from scipy.signal import lfilter

from simulation.arrays import FloatArray


def red_noise(rng: np.random.Generator, n: int, n_correlated: float) -> FloatArray:
    """Return AR(1) noise of unit variance. Shape (n,)."""
    a = float(np.exp(-1.0 / n_correlated))
    series = lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], rng.standard_normal(n + 200))[200:]
    return np.asarray(series, dtype=np.float64)
