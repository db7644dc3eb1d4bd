"""Profile likelihoods: the least error that each value of a parameter leaves, and where it becomes too large.

With the others at their best, minus twice the logarithm of the density rises above that of the best point by
less than the quantile of chi squared of one degree of freedom for as many measurements as the level says
(Raue et al. 2009, doi:10.1093/bioinformatics/btp358). No normal posterior is assumed, and no prior but those
that are declared; a ridge is seen as a profile that stays low up to a bound.
"""

from dataclasses import dataclass
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.descent import Residuals, descend_together
from studies.calibration.prior import Prior
from studies.calibration.uncertainty.findings import ENDS

LIMIT = NormalDist().inv_cdf(ENDS[1])
"""Root of the rise of -2 log L at the ends of an interval: 1.645 for 90 %."""

BEYOND, MOST_STEPS = 2.0, 16
"""A profile is followed to this root of the rise or to a bound, in so many steps at most."""

STEPS_PER_END, WIDENED, STEP_BETWEEN = 3.0, 1.3, (1e-6, 0.2)
"""Steps that half an interval may take, how much longer each is than the last, limits of the first."""

N_REFINED = 5
"""Steps of the regula falsi between the last value within the interval and the first beyond."""


NEAR = 0.01
"""A value whose root lies so near `LIMIT` is the end of an interval."""


class Step(NamedTuple):
    """A point of a profile: the parameter's value [1], the least objective [unit squared], and where (p,)."""

    value: float
    objective: float
    u: FloatArray


@dataclass(frozen=True, eq=False)
class Profiles:
    """What each value of each parameter leaves.

    Attributes:
        at: Values of the parameters, rising, NaN where a profile has fewer. Shape (p, g). [1]
        roots: Root of the rise of -2 log L there. Shape (p, g). [1]
        ends: Ends of the intervals, a bound where a profile stays within. Shape (2, p). [1]
        points: The best points there. Shape (2, p, p). [1]
        is_open: Where a profile stays within up to the bound. Shape (2, p).
        best: The point that all profiles leave. Shape (p,). [1]
    """

    at: FloatArray
    roots: FloatArray
    ends: FloatArray
    points: FloatArray
    is_open: BoolArray
    best: FloatArray


class _Walks:
    """The two sides of every profile, each a list of steps from the best point outward."""

    def __init__(self, residuals: Residuals, prior: Prior | None, best: FloatArray, unit: float) -> None:
        self._residuals, self._prior, self._unit = residuals, prior, unit
        ends, values = descend_together(residuals, prior, best[None])
        self.best = ends[0]
        p = best.size
        self.parameter, self.side = np.tile(np.arange(p), 2), np.repeat([-1.0, 1.0], p)
        self.steps = [[Step(float(ends[0, j]), float(values[0]), ends[0])] for j in self.parameter]

    def add(self, to: dict[int, tuple[float, FloatArray]]) -> None:
        """Follow some sides to a value each, from a start (p,) each; all are asked together."""
        rows = np.array(list(to), dtype=np.int64)
        starts = np.array([start for _, start in to.values()])
        is_held = np.arange(starts.shape[1]) == self.parameter[rows, None]
        values = np.array([value for value, _ in to.values()])
        starts = np.where(is_held, values[:, None], starts)
        found, left = descend_together(self._residuals, self._prior, starts, is_held)
        for row, value, objective, u in zip(to, values.tolist(), left.tolist(), found, strict=True):
            self.steps[row].append(Step(value, objective, u))
            self.steps[row].sort(key=lambda one, side=self.side[row]: side * one.value)

    def root(self, step: Step) -> float:
        """Return the root of the rise of -2 log L above the lowest point of all profiles."""
        lowest = min(one.objective for steps in self.steps for one in steps)
        return float(np.sqrt(max(step.objective - lowest, 0.0) / self._unit))

    def bracket(self, row: int) -> tuple[Step, Step | None]:
        """Return the last step of a side within its interval and the first beyond, None for none."""
        steps = self.steps[row]
        first = next((n for n, one in enumerate(steps) if n and self.root(one) >= LIMIT), None)
        return (steps[-1], None) if first is None else (steps[first - 1], steps[first])

    def end(self, row: int) -> Step:
        """Return the step of a side that is nearest to the end of its interval."""
        within, beyond = self.bracket(row)
        return within if beyond is None else min(within, beyond, key=lambda one: abs(self.root(one) - LIMIT))


def profiles(
    residuals: Residuals, prior: Prior | None, best: FloatArray, half: FloatArray, unit: float
) -> Profiles:
    """Follow the profile of every parameter from the best point to both sides.

    Args:
        residuals: Points (n, p) to residuals (n, m), which cost nothing.
        prior: Of the parameters, weighed as in the posterior; None where nothing is known.
        best: The calibrated point. Shape (p,). [1]
        half: Half of the intervals, about. Shape (p,). [1]
        unit: What the error rises by where -2 log L does by 1. [unit squared]
    """
    walks, p = _Walks(residuals, prior, best, unit), best.size
    length = np.clip(np.tile(half, 2) / STEPS_PER_END, *STEP_BETWEEN)
    left = set(range(2 * p))
    for n in range(MOST_STEPS):
        last = {row: walks.steps[row][-1] for row in sorted(left)}
        ahead = {row: walks.side[row] * length[row] * WIDENED**n for row in last}
        walks.add({row: (min(max(one.value + ahead[row], 0.0), 1.0), one.u) for row, one in last.items()})
        ends = {row: walks.steps[row][-1] for row in left}
        left = {row for row, one in ends.items() if walks.root(one) < BEYOND and 0.0 < one.value < 1.0}
        if not left:
            break
    for _ in range(N_REFINED):
        to = dict[int, tuple[float, FloatArray]]()
        for row in range(2 * p):
            within, beyond = walks.bracket(row)
            if beyond is not None and abs(walks.root(walks.end(row)) - LIMIT) > NEAR:
                low, high = walks.root(within), walks.root(beyond)
                share = min(max((LIMIT - low) / (high - low), 0.05), 0.95)
                to[row] = (within.value + share * (beyond.value - within.value), within.u)
        if not to:
            break
        walks.add(to)
    whole = [[*walks.steps[j][:0:-1], *walks.steps[p + j]] for j in range(p)]
    at, roots = np.full((2, p, max(map(len, whole))), np.nan)
    for j, steps in enumerate(whole):
        at[j, : len(steps)] = [one.value for one in steps]
        roots[j, : len(steps)] = [walks.root(one) for one in steps]
    ends = [walks.end(row) for row in range(2 * p)]
    return Profiles(
        at=at,
        roots=roots,
        ends=np.array([one.value for one in ends]).reshape(2, p),
        points=np.array([one.u for one in ends]).reshape(2, p, p),
        is_open=np.array([walks.bracket(row)[1] is None for row in range(2 * p)]).reshape(2, p),
        best=walks.best,
    )
