"""Time grid, place and noise that weather and operation of the virtual measurement share."""

import numpy as np
import pandas as pd
from numpy.typing import NDArray

Array = NDArray[np.float64]

FIRST_DAY = pd.Timestamp("2018-02-21", tz="Etc/GMT-1")  # a Wednesday, Central European Time
STEP_S = 60
DAY_S = 86400
WARM_UP_DAYS = 12  # simulated before the first row, so that walls and slab have a history
RECORDED_DAYS = 22


def time_grid() -> Array:
    """Return the start of every simulation step, zero at the first row. Shape (t,). [s]."""
    return np.arange(-WARM_UP_DAYS * DAY_S, RECORDED_DAYS * DAY_S, STEP_S, dtype=np.float64)


def hour_of_day(t: Array) -> Array:
    """Return the local hour. Shape (t,). [h]."""
    return 24.0 * np.mod(t / DAY_S, 1.0)


def day_number(t: Array) -> NDArray[np.int64]:
    """Return the day, counted from the first row. Shape (t,). [1]."""
    return np.floor(t / DAY_S).astype(np.int64)


def red_noise(rng: np.random.Generator, n: int, correlation_s: float) -> Array:
    """Draw a first-order autoregressive series of unit variance on the simulation grid. Shape (n,). [1]."""
    decay = float(np.exp(-STEP_S / correlation_s))
    shocks = rng.standard_normal(n) * np.sqrt(1.0 - decay**2)
    series = np.empty(n)
    level = float(rng.standard_normal())
    for i, shock in enumerate(shocks):
        level = decay * level + shock
        series[i] = level
    return series


def lagged(series: Array, lag_s: Array | float) -> Array:
    """Return the first-order lag of a series; the lag may change with time. Shape (t,)."""
    share = -np.expm1(-STEP_S / np.broadcast_to(np.asarray(lag_s, dtype=np.float64), series.shape))
    out = np.empty_like(series)
    level = float(series[0])
    for i, (target, weight) in enumerate(zip(series, share, strict=True)):
        level += weight * (target - level)
        out[i] = level
    return out
