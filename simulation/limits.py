"""Limits of outputs: what a simulation has to keep, and how far it does not."""

from dataclasses import dataclass, replace

import numpy as np

from simulation.arrays import FloatArray
from simulation.samples import Samples


@dataclass(frozen=True, eq=False)
class Limits:
    """Values between which an output has to stay; only what lies beyond counts.

    Attributes:
        time: Output times at which they hold. Shape (m,). [s]
        at_least: Lower limit, minus infinity for none. [output's unit]
        at_most: Upper limit, infinity for none. [output's unit]
        is_alone: Whether the output has no measurement beside them.
    """

    time: FloatArray
    at_least: float
    at_most: float
    is_alone: bool

    @property
    def samples(self) -> Samples:
        """What stands in place of samples: the upper limit, or the lower one without it, at all times."""
        end = self.at_most if np.isfinite(self.at_most) else self.at_least
        return Samples(self.time, np.full(self.time.shape, end))

    def excess(self, values: FloatArray) -> FloatArray:
        """Return how far values lie beyond: below 0 under the lower limit. Shape as they have. [unit]."""
        return values - np.clip(values, self.at_least, self.at_most)

    def within(self, begin_s: float, length_s: float) -> "Limits":
        """Return the same with times from a begin on, for `length_s` at most. [s]."""
        return replace(self, time=np.clip(self.time - begin_s, 0.0, length_s))

    def __repr__(self) -> str:
        """Say all that decides errors, for digests."""
        ends = f"{len(self.time)} from {self.time[0]!r} to {self.time[-1]!r}"
        return f"Limits({self.at_least!r}, {self.at_most!r}, {self.is_alone}, {ends})"
