"""The coordinates of the search: which hyperparameters, on which scale, and what they mean as settings."""

import math
from collections.abc import Mapping
from typing import Any

from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution

from studies.search_ranges import POWERS_OF_TWO, WHOLE, SearchRanges

LOGARITHMIC = ("beta", "learning_rate")
SAME_DIGITS = 6  # settings that agree to so many digits are one configuration

Params = dict[str, float | int]


def distributions(ranges: SearchRanges) -> dict[str, BaseDistribution]:
    """Return the search coordinates: widths as exponents of two, weights and rates on a logarithmic scale."""
    found: dict[str, BaseDistribution] = {}
    for name in POWERS_OF_TWO:
        if (span := getattr(ranges, name)) is None:
            continue
        low, high = span
        found[f"log2_{name}"] = IntDistribution(math.ceil(math.log2(low)), math.floor(math.log2(high)))
    for name in LOGARITHMIC:
        if (span := getattr(ranges, name)) is not None:
            found[name] = FloatDistribution(span[0], span[1], log=True)
    for name in WHOLE:
        if (span := getattr(ranges, name)) is not None:
            found[name] = IntDistribution(span[0], span[1])
    return found


def to_settings(params: Mapping[str, float | int]) -> dict[str, Any]:
    """Translate search coordinates into settings of the surrogate."""
    return {
        (name.removeprefix("log2_")): (2 ** int(value) if name.startswith("log2_") else value)
        for name, value in params.items()
    }


def nearest_params(ranges: SearchRanges, settings: Mapping[str, Any]) -> Params:
    """Translate settings of the surrogate into search coordinates, clipped into the ranges."""
    found: Params = {}
    for name, distribution in distributions(ranges).items():
        value = settings[name.removeprefix("log2_")]
        value = math.log2(value) if name.startswith("log2_") else float(value)
        assert isinstance(distribution, IntDistribution | FloatDistribution)
        value = min(max(value, distribution.low), distribution.high)
        found[name] = round(value) if isinstance(distribution, IntDistribution) else value
    return found


def same_settings(one: Params, other: Params) -> bool:
    """Say whether two points of the search are one configuration."""
    return identity(one) == identity(other)


def identity(params: Params) -> tuple[tuple[str, str], ...]:
    """Return what tells a configuration from others."""
    return tuple((name, f"{params[name]:.{SAME_DIGITS}g}") for name in sorted(params))


def all_points(ranges: SearchRanges) -> list[Params] | None:
    """Return every point of the search, None where they are without number."""
    points: list[Params] = [{}]
    for name, distribution in distributions(ranges).items():
        if isinstance(distribution, IntDistribution):
            values: list[float | int] = list(range(distribution.low, distribution.high + 1))
        elif isinstance(distribution, FloatDistribution) and distribution.single():
            values = [distribution.low]
        else:
            return None
        points = [{**point, name: value} for point in points for value in values]
    return points
