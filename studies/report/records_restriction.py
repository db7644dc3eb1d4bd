"""What is told of a calibration of the most relevant parameters: what it fixed, and what that cost."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class RestrictionRecord:
    """Which parameters a calibration left out, and what is known of that choice.

    Attributes:
        n_free: Parameters that were calibrated.
        fixed: Names of the others.
        shares: Share of each parameter in what varies, by name; None where it is not known. [1]
        source: What says so: "Sobol" or "Morris".
        n_calls: Calls for that, made first of all.
        n_calls_before: Calls that stored Sobol indices had cost before.
        gain: Part of the error that freeing all others would take away; None where not checked. [1]
        gain_alone: The same for each of them alone, by name; None where its simulation failed, empty where
            not checked. [1]
        n_check: Calls of that check.
    """

    n_free: int
    fixed: tuple[str, ...]
    shares: Mapping[str, float | None]
    source: str
    n_calls: int = 0
    n_calls_before: int = 0
    gain: float | None = None
    gain_alone: Mapping[str, float | None] = field(default_factory=dict)
    n_check: int = 0

    @property
    def closest_call(self) -> tuple[str, str] | None:
        """The least relevant parameter that was calibrated and the most relevant one that was not."""
        known = {name: share for name, share in self.shares.items() if share is not None}
        fixed = [name for name in known if name in self.fixed]
        free = [name for name in known if name not in self.fixed]
        return (
            (min(free, key=known.__getitem__), max(fixed, key=known.__getitem__)) if free and fixed else None
        )


def restriction_record(numbers: Mapping[str, Any]) -> RestrictionRecord | None:
    """Return what a calibration's numbers tell of its restriction, None for one of all parameters."""
    if "restriction" not in numbers:
        return None
    told = numbers["restriction"]
    check = told["check"] or {"gain": None, "gain_alone": {}, "n_calls": 0}
    return RestrictionRecord(
        n_free=told["n_free"],
        fixed=tuple(told["fixed"]),
        shares=told["shares"],
        source=told["source"],
        n_calls=told["n_calls"],
        n_calls_before=told["n_calls_before"],
        gain=check["gain"],
        gain_alone=check["gain_alone"],
        n_check=check["n_calls"],
    )
