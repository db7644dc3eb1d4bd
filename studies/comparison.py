"""Two sets of numbers side by side, equal to the last digit or not."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from studies.report.wording import count


@dataclass(frozen=True)
class Compared:
    """One number, text or row of numbers, recorded and made again.

    Args:
        name: what it is.
        recorded: as it was recorded, in all its digits.
        now: as it came out now.
        is_equal: whether they are the same to the last digit.
        relative: largest difference over the recorded value; None where it has no meaning. [1]
    """

    name: str
    recorded: str
    now: str
    is_equal: bool
    relative: float | None = None


def compare(recorded: Mapping[str, Any], now: Mapping[str, Any]) -> list[Compared]:
    """Compare every number that was recorded.

    Args:
        recorded: nested JSON values and arrays, by name; a list or array of numbers is one row.
        now: the same made again; what was not recorded is left out.
    """
    was, is_now = dict(_leaves(recorded)), dict(_leaves(now))
    return [_compared(name, value, is_now.get(name)) for name, value in was.items()]


def _leaves(content: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def _compared(name: str, recorded: Any, now: Any) -> Compared:
    was, is_now = np.asarray(recorded), np.asarray(now)
    are_numbers = all(np.issubdtype(one.dtype, np.number) for one in (was, is_now))
    is_equal = bool(np.array_equal(was, is_now, equal_nan=are_numbers))
    if is_equal or not are_numbers or was.shape != is_now.shape:
        shown = "the same" if is_equal and was.ndim else _text(now)
        return Compared(name, _text(recorded), shown, is_equal, 0.0 if is_equal and are_numbers else None)
    same = (was == is_now) | (np.isnan(was) & np.isnan(is_now))
    with np.errstate(all="ignore"):
        relative = float(np.nanmax(np.abs(is_now - was)) / max(np.nanmax(np.abs(was)), 1e-300))
    first = int(np.flatnonzero(~same.ravel())[0])
    differ = f"{int((~same).sum())} differ, the first is [{first}]" if was.ndim else _text(now)
    return Compared(name, _text(recorded), differ, False, relative if math.isfinite(relative) else None)


def _text(value: Any) -> str:
    if isinstance(value, np.ndarray | list | tuple):
        return count(np.size(value), "value")
    return "–" if value is None else repr(value) if isinstance(value, int | float) else str(value)
