"""What a posterior sample says in plain words: which parameters are known, and which only together."""

import math
from collections.abc import Collection
from dataclasses import dataclass
from itertools import combinations
from statistics import NormalDist

import numpy as np

from simulation.arrays import FloatArray
from simulation.parameters import ParameterSpace
from studies.calibration.prior import Prior

LEVEL = 0.9
"""Probability of intervals and bands."""

ENDS = 0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL
"""Shares of the probability below the two ends of an interval."""

DETERMINED_TO, OPEN = 0.33, 0.7
"""Widths of an interval, as shares of the range where nothing was known before: below the first the data
determine a parameter, above the second they say next to nothing (0.9 is the width without any data)."""

CLEARLY_BEYOND = 0.5
"""A combination counts as known where its spread is below this share of that of either of the two."""

NAMED = 0.6
"""Correlation from which two parameters are said to compensate each other though no product is known."""

MOST_NAMED = 6
"""Pairs that are named."""


@dataclass(frozen=True)
class Compensation:
    """Two parameters of which one makes up for the other.

    Attributes:
        first: Name of the one.
        second: Name of the other.
        correlation: Of their logarithms, or values where the scale is linear. [1]
        known: "product" or "ratio", and "" where neither is known clearly better than the two.
        known_within: Half the interval of the known one's logarithm. [1]
        alone_within: The smaller one of the two parameters'. [1]
    """

    first: str
    second: str
    correlation: float
    known: str
    known_within: float
    alone_within: float

    @property
    def in_words(self) -> str:
        """The sentence."""
        both = f"{self.first} and {self.second}"
        how = "compensate each other" if self.correlation < 0 else "rise and fall together"
        if not self.known:
            return f"{both} {how} (correlation {self.correlation:+.2f})".replace("-", "\N{MINUS SIGN}")
        return (
            f"{both} {how}: only their {self.known} is known, {within(self.known_within)}, "
            f"each alone {within(self.alone_within)} at best"
        )


def within(half: float) -> str:
    """Write half an interval of a logarithm, e.g. "to 3 %" or "within a factor of 2.1"."""
    # Above it percents mislead: so many more and so many less are no longer the same factor.
    if half < math.log(1.5):
        percents = 100.0 * math.expm1(half)
        return f"to {percents:.1f} %" if percents < 1.0 else f"to {percents:.0f} %"
    return f"within a factor of {math.exp(half):.2g}"


def compensations(space: ParameterSpace, u: FloatArray) -> tuple[Compensation, ...]:
    """Return the pairs of parameters that a sample shows to compensate each other, the clearest first.

    Args:
        space: The parameters.
        u: The sample. Shape (n, p). [1]
    """
    widths = np.ones(space.n_parameters)
    # So u becomes the logarithm but for a constant, in which a product is a sum.
    widths[space.is_log] = np.log(space.upper[space.is_log] / space.lower[space.is_log])
    x = u * widths
    found = []
    for i, j in combinations(range(space.n_parameters), 2):
        deviations = x[:, i].std(), x[:, j].std()
        # A parameter that does not vary has no correlation: it would be 0 / 0.
        if min(deviations) <= 0.0:
            continue
        together = float(np.corrcoef(x[:, i], x[:, j])[0, 1])
        # What falls as the other rises leaves the product; what rises with it leaves the ratio.
        pair = x[:, i] + x[:, j] if together < 0 else x[:, i] - x[:, j]
        # On linear scales the sum would add quantities of different units.
        both_log = bool(space.is_log[i] and space.is_log[j])
        is_known = both_log and float(pair.std()) < CLEARLY_BEYOND * min(deviations)
        if is_known or abs(together) >= NAMED:
            known = ("product" if together < 0 else "ratio") if is_known else ""
            alone = min(_half(x[:, i]), _half(x[:, j]))
            name_i, name_j = space.names[i], space.names[j]
            found.append(Compensation(name_i, name_j, together, known, _half(pair), alone))
    found.sort(key=lambda one: (not one.known, -abs(one.correlation)))
    return tuple(found[:MOST_NAMED])


def knowledge(
    space: ParameterSpace, u: FloatArray, determined: Collection[str], prior: Prior | None = None
) -> dict[str, str]:
    """Say of each parameter what the data say: "determined", "narrowed", "open" or, of a prior's, "prior".

    An interval counts as a share of what it would be without data: nine tenths of the range, or the prior's.

    Args:
        space: The parameters.
        u: A posterior sample. Shape (n, p). [1]
        determined: Parameters that the slopes at the point determine, as a calibration judges them. No other
            is called so: along a long, narrow valley a sample may be too short.
        prior: What was known beforehand, or None.
    """
    low, high = np.quantile(u, ENDS, axis=0)
    found = {}
    for j, name in enumerate(space.names):
        # Against the interval without data: else a narrow prior alone would make a parameter determined.
        before, left_open = LEVEL, "open"
        if prior is not None and prior.is_held[j]:
            before, left_open = _width(float(prior.centre[j]), float(prior.width[j])), "prior"
        # Without data it becomes 0.9, with or without a prior, so one pair of limits serves both.
        share = float(high[j] - low[j]) * LEVEL / before
        is_determined = share < DETERMINED_TO and name in determined
        found[name] = "determined" if is_determined else left_open if share > OPEN else "narrowed"
    return found


def _width(centre: float, deviation: float) -> float:
    """Return the width of the interval of a normal distribution that the unit interval cuts off. [1]."""
    normal = NormalDist(centre, deviation)
    # Quantiles of a truncated normal distribution: ranks are counted between the bounds alone.
    least, most = normal.cdf(0.0), normal.cdf(1.0)
    low, high = (normal.inv_cdf(least + (most - least) * share) for share in ENDS)
    return high - low


def _half(x: FloatArray) -> float:
    low, high = np.quantile(x, ENDS)
    return 0.5 * float(high - low)
