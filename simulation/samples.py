"""Samples of an output at times of their own, moments or means, and where they lie among the output times."""

from dataclasses import dataclass, replace

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray

MOMENT = (0.0, 0.0)
"""Interval of a sample that is no mean."""
# A sample this close to an output time, as a share of the output step, lies on it.
_ON_GRID = 1e-6


@dataclass(frozen=True, eq=False)
class Samples:
    """What was measured of one output: at its own times, gaps left out.

    Attributes:
        time: Sample times, rising. Shape (m,). [s]
        values: Measured values. Shape (m,). [output's unit]
        interval: Of means: from when on and until when each of them goes, relative to its time; (0, 0) for
            values of moments. [s]
        stamps: The times as the recording writes them, to be found there again; empty where there is none.
        deviations: Standard uncertainty of each; None where all have that of the sensor. Shape (m,).
            [output's unit]
        since_s: Of a counter: from when on it counts; None for values as they are. [s]
    """

    time: FloatArray
    values: FloatArray
    interval: tuple[float, float] = MOMENT
    stamps: tuple[str, ...] = ()
    deviations: FloatArray | None = None
    since_s: float | None = None

    def __post_init__(self) -> None:
        if self.time.shape != self.values.shape or self.time.ndim != 1:
            raise ValueError(f"times {self.time.shape} and values {self.values.shape} do not fit")
        if not len(self.time):
            raise ValueError("an output without a sample cannot be compared")
        if not (np.isfinite(self.time).all() and np.isfinite(self.values).all()):
            raise ValueError("a sample is not finite; leave gaps out")
        if np.any(np.diff(self.time) <= 0):
            raise ValueError("sample times do not rise")
        if self.deviations is not None and not (
            self.deviations.shape == self.time.shape and np.all(self.deviations > 0.0)
        ):
            raise ValueError("each sample needs an uncertainty above 0")
        if self.interval[0] > self.interval[1]:
            raise ValueError(f"an interval from {self.interval[0]} to {self.interval[1]} s has no length")

    @property
    def are_means(self) -> bool:
        """Whether each is the mean over an interval, not the value of a moment."""
        return self.interval != MOMENT

    @property
    def begin_s(self) -> float:
        """From when on the first one says something. [s]."""
        first_s = float(self.time[0]) + self.interval[0]
        return first_s if self.since_s is None else min(first_s, self.since_s)

    def place_on(self, grid: FloatArray) -> "Place | MeanPlace | CountPlace":
        """Find them among the output times (t,), which must hold all of them. [s]."""
        if self.since_s is not None:
            return CountPlace(place_of(grid, self.time), place_of(grid, np.array([self.since_s])))
        if not self.are_means:
            return place_of(grid, self.time)
        first, last = (_inside(grid, self.time + one) for one in self.interval)
        return MeanPlace(np.diff(grid), place_of(grid, first), place_of(grid, last), last - first)

    @property
    def usual_deviation(self) -> float | None:
        """The deviation that all would have for the same sum of weights 1 / deviation^2. [output's unit]."""
        if self.deviations is None:
            return None
        return float(np.mean(self.deviations**-2.0) ** -0.5)

    def beside(self, time: FloatArray, simulated: FloatArray) -> FloatArray:
        """Return the values as they stand beside a simulation: a counter begins where the simulation is then.

        Args:
            time: Output times. Shape (t,). [s]
            simulated: The output. Shape (t,). [output's unit]
        """
        return self.values if self.since_s is None else self.values + np.interp(self.since_s, time, simulated)

    def taken(self, kept: BoolArray, interval: tuple[float, float]) -> "Samples":
        """Return some of them, of another interval [s] and without stamps. Mask of shape (m,)."""
        deviations = None if self.deviations is None else self.deviations[kept]
        return Samples(self.time[kept], self.values[kept], interval, deviations=deviations)

    def within(self, begin_s: float, length_s: float) -> "Samples":
        """Return the same with times from a begin on, for `length_s` at most. [s]."""
        since_s = None if self.since_s is None else max(self.since_s - begin_s, 0.0)
        return replace(self, time=np.clip(self.time - begin_s, 0.0, length_s), since_s=since_s)


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


@dataclass(frozen=True, eq=False)
class CountPlace:
    """Between which output times samples of a counter lie, and where it begins to count."""

    at: Place
    since: Place

    def of(self, series: FloatArray) -> FloatArray:
        """Return how far series (n, t) have counted there. Shape (n, m)."""
        return self.at.of(series) - self.since.of(series)


@dataclass(frozen=True, eq=False)
class MeanPlace:
    """Between which output times the intervals of means begin and end.

    Attributes:
        steps: Steps between the t output times. Shape (t - 1,). [s]
        first: Where the intervals begin.
        last: Where they end.
        length: Their lengths. Shape (m,). [s]
    """

    steps: FloatArray
    first: Place
    last: Place
    length: FloatArray

    def of(self, series: FloatArray) -> FloatArray:
        """Return the means of series (n, t) there, of straight lines between output times. Shape (n, m)."""
        # Relative to the first value, integrals stay small and keep their digits.
        level = series[:, :1]
        rest = series - level
        whole = np.zeros(rest.shape)
        np.cumsum(0.5 * (rest[:, 1:] + rest[:, :-1]) * self.steps, axis=1, out=whole[:, 1:])

        def until(place: Place) -> FloatArray:
            begin, end = rest[:, place.before], rest[:, place.after]
            step = self.steps[np.minimum(place.before, len(self.steps) - 1)]
            part = place.share * (begin + 0.5 * place.share * (end - begin))
            return np.asarray(whole[:, place.before] + part * step)

        return np.asarray((until(self.last) - until(self.first)) / self.length + level)


def _inside(grid: FloatArray, time: FloatArray) -> FloatArray:
    """Return times (m,) of which a rounding put none outside of the output times (t,). [s]."""
    inside = np.clip(time, grid[0], grid[-1])
    slack = _ON_GRID * float(np.max(np.diff(grid), initial=0.0))
    return np.where(np.abs(time - inside) <= slack, inside, time)


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
