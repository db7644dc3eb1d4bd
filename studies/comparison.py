"""Two sets of numbers side by side, equal to the last digit or not."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

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

    def to_dict(self) -> dict[str, Any]:
        """Return JSON values."""
        return asdict(self)


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
    if isinstance(recorded, np.ndarray | list | tuple):
        return _compared_rows(name, np.asarray(recorded), None if now is None else np.asarray(now))
    if _is_number(recorded) and _is_number(now):
        is_equal = recorded == now or (math.isnan(recorded) and math.isnan(now))
        difference = 0.0 if is_equal else abs(now - recorded) / max(abs(recorded), 1e-300)
        return Compared(name, repr(recorded), repr(now), is_equal, float(difference))
    return Compared(name, _text(recorded), _text(now), recorded == now)


def _compared_rows(name: str, recorded: NDArray[Any], now: NDArray[Any] | None) -> Compared:
    said = count(recorded.size, "value")
    if now is None or recorded.shape != now.shape:
        shape = "–" if now is None else count(now.size, "value")
        return Compared(name, said, shape, False)
    if not all(np.issubdtype(one.dtype, np.number) for one in (recorded, now)):
        is_equal = bool(np.array_equal(recorded, now))
        return Compared(name, said, "the same" if is_equal else "others", is_equal)
    same = (recorded == now) | (np.isnan(recorded) & np.isnan(now))
    if same.all():
        return Compared(name, said, "the same", True, 0.0)
    with np.errstate(all="ignore"):
        scale = np.nanmax(np.abs(recorded)) if recorded.size else 1.0
        relative = float(np.nanmax(np.abs(now - recorded)) / max(scale, 1e-300))
    first = int(np.flatnonzero(~same.ravel())[0])
    differ = f"{int((~same).sum())} differ, the first is [{first}]"
    return Compared(name, said, differ, False, relative if math.isfinite(relative) else None)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _text(value: Any) -> str:
    return "–" if value is None else str(value)


def shortened(text: str, length: int = 40) -> str:
    """Return a digest's first digits, and the begin of a long text."""
    if re.fullmatch(r"[0-9a-f]{64}", text):
        return text[:12]
    return text if len(text) <= length else f"{text[: length - 1]}…"


def n_equal(rows: Sequence[Compared]) -> int:
    """Return how many rows are equal."""
    return sum(row.is_equal for row in rows)
