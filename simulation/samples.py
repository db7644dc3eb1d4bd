"""Samples of an output at times of their own, and where they lie among the output times."""

from dataclasses import dataclass, replace

import numpy as np

from simulation.arrays import FloatArray, IntArray

# A sample this close to an output time, as a share of the output step, lies on it.
_ON_GRID = 1e-6


@dataclass(frozen=True, eq=False)
class Samples:
    """What was measured of one output: at its own times, gaps left out.

    Attributes:
        time: Sample times, rising. Shape (m,). [s]
        values: Measured values. Shape (m,). [output's unit]
        stamps: The times as the recording writes them, to be found there again; empty where there is none.
    """

    time: FloatArray
    values: FloatArray
    stamps: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.time.shape != self.values.shape or self.time.ndim != 1:
            raise ValueError(f"times {self.time.shape} and values {self.values.shape} do not fit")
        if not len(self.time):
            raise ValueError("an output without a sample cannot be compared")
        if not (np.isfinite(self.time).all() and np.isfinite(self.values).all()):
            raise ValueError("a sample is not finite; leave gaps out")
        if np.any(np.diff(self.time) <= 0):
            raise ValueError("sample times do not rise")

    def within(self, begin_s: float, length_s: float) -> "Samples":
        """Return the same with times from a begin on, for `length_s` at most. [s]."""
        return replace(self, time=np.clip(self.time - begin_s, 0.0, length_s))


@dataclass(frozen=True, eq=False)
class Place:
    """Between which output times samples lie, and how far towards the later one. Shape (m,) each."""

    before: IntArray
    after: IntArray
    share: FloatArray
    is_whole_grid: bool

    def of(self, series: FloatArray) -> FloatArray:
        """Return what series (n, t) are there, by straight lines. Shape (n, m)."""
        if self.is_whole_grid:
            return series
        found = series[:, self.before] * (1.0 - self.share)
        found += series[:, self.after] * self.share
        return found


def place_of(grid: FloatArray, time: FloatArray) -> Place:
    """Find samples among the output times; the share is exactly 0 or 1 on one of them."""
    before = np.clip(np.searchsorted(grid, time, side="right") - 1, 0, max(len(grid) - 2, 0))
    after = np.minimum(before + 1, len(grid) - 1)
    share = (time - grid[before]) / np.where(after > before, grid[after] - grid[before], 1.0)
    share[np.abs(share) < _ON_GRID] = 0.0
    share[np.abs(share - 1.0) < _ON_GRID] = 1.0
    outside = (share < 0.0) | (share > (after > before))
    if outside.any():
        raise ValueError(
            f"a sample at {time[outside][0]:g} s lies outside the output times, {grid[0]:g} to {grid[-1]:g} s"
        )
    at = before + share.astype(np.int64)
    is_whole_grid = not (share % 1.0).any() and np.array_equal(at, np.arange(len(grid)))
    return Place(before, after, share, is_whole_grid)
