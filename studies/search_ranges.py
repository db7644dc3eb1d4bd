"""The ranges in which hyperparameters are searched, and which of them a variant has."""

import math
from dataclasses import asdict
from typing import Annotated

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

STRICT = ConfigDict(extra="forbid", strict=False)
Count = Annotated[int, Field(ge=1, le=1_000_000)]
Positive = Annotated[float, Field(gt=0.0)]
Layers = Annotated[int, Field(ge=2, le=1_000)]
Degree = Annotated[int, Field(ge=1, le=2)]
POWERS_OF_TWO = ("n_latent", "n_hidden")
WHOLE = ("n_layers", "n_scales", "degree")
OF_NETWORKS = ("n_latent", "n_hidden", "beta", "learning_rate", "n_layers")
OF_PROCESSES = ("n_scales", "degree")


@dataclass(frozen=True, config=STRICT)
class SearchRanges:
    """Ranges of the hyperparameters, both ends included; one that has none is held at the variant's value.

    Args:
        n_latent: latent dimension, searched in powers of two.
        n_hidden: hidden width, searched in powers of two.
        beta: weight of the reconstruction term (Eq. 4), searched on a logarithmic scale.
        learning_rate: searched on a logarithmic scale.
        n_layers: number of linear layers, at least 2.
        n_scales: scales of a Gaussian process's kernel.
        degree: of the polynomial in a Gaussian process's kernel, 1 or 2.
    """

    n_latent: tuple[Count, Count] | None = None
    n_hidden: tuple[Count, Count] | None = None
    beta: tuple[Positive, Positive] | None = None
    learning_rate: tuple[Positive, Positive] | None = None
    n_layers: tuple[Layers, Layers] | None = None
    n_scales: tuple[Count, Count] | None = None
    degree: tuple[Degree, Degree] | None = None

    def __post_init__(self) -> None:
        for name, span in asdict(self).items():
            if span is not None and span[0] > span[1]:
                raise ValueError(f"{name} must be [low, high], got {list(span)}")
            if span is not None and name in POWERS_OF_TWO and not _n_powers_of_two(*span):
                raise ValueError(f"{name} must hold a power of two, got {list(span)}")

    @property
    def names(self) -> list[str]:
        """What is searched."""
        return [name for name, span in asdict(self).items() if span is not None]

    @property
    def n_configurations(self) -> int | None:
        """Number of configurations within the ranges, None where they are without number."""
        n = 1
        for name, span in asdict(self).items():
            if span is None:
                continue
            low, high = span
            if name in POWERS_OF_TWO:
                n *= _n_powers_of_two(low, high)
            elif name in WHOLE:
                n *= high - low + 1
            elif low < high:
                return None
        return n

    def fault(self, name: str, value: float) -> str:
        """Say why a setting cannot be tried, nothing where it can."""
        searched = {key: span for key, span in asdict(self).items() if span is not None}
        if name not in searched:
            return "is not searched; give it a range in [tuning.search], or leave it out"
        low, high = searched[name]
        if not low <= value <= high:
            return f"lies outside its range, {low} to {high}; correct it, or widen [tuning.search]"
        if name in POWERS_OF_TWO and not math.log2(value).is_integer():
            return "is no power of two, which is how this width is searched"
        if name in WHOLE and not float(value).is_integer():
            return "must be whole"
        return ""


def _n_powers_of_two(low: float, high: float) -> int:
    return max(0, math.floor(math.log2(high)) - math.ceil(math.log2(low)) + 1)


NETWORK_RANGES = SearchRanges(n_latent=(8, 128), n_hidden=(64, 256), beta=(1.0, 1000.0))
"""Searched for a variant of networks where the profile names no ranges."""
PROCESS_RANGES = SearchRanges(n_scales=(1, 4), degree=(1, 2))
"""Searched for a variant of Gaussian processes where the profile names no ranges."""
