"""Timestamps as text: what moment each means, and the traps of clocks that are set forward and back."""

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, tzinfo
from typing import Literal
from zoneinfo import ZoneInfo

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.foreign_text import quoted

Clock = Literal["seconds", "local", "utc"]
FIRST = "first"
"""In place of a timestamp: the first row of a recording."""

# Day first: with points no other order is in use.
_DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})[ T]+(\d{1,2}):(\d{2})(?::(\d{2}))?")


def read_timestamps(
    cells: Sequence[str], zone: tzinfo | None, where: Callable[[int], str]
) -> tuple[FloatArray, Clock]:
    """Return the moments of a column and what they count from.

    Args:
        cells: The timestamps: ISO 8601, or day.month.year hour:minute.
        zone: Where the clock of timestamps without an offset hangs; None for one that is never set.
        where: Names the place of a cell by its number, for messages.

    Returns:
        Seconds since 1970, shape (m,), in UTC or on the local clock.

    Raises:
        InputError: If one is no timestamp, or some have an offset and some have not.
    """
    seconds, has_offset = np.empty(len(cells)), False
    for row, cell in enumerate(cells):
        if not cell:
            raise InputError(f"{where(row)}: the time is missing; add it, or remove the line")
        try:
            moment = _parsed(cell)
        except ValueError:
            raise InputError(
                f"{where(row)}: {quoted(cell)} is no timestamp; write 2018-02-21T00:30:00+01:00 or "
                "21.02.2018 00:30, or seconds in a column time_s, or a unit in its name, as in time [h]"
            ) from None
        has_offset = has_offset if row else moment.tzinfo is not None
        if (moment.tzinfo is not None) != has_offset:
            raise InputError(
                f"{where(row)}: {cell} is not written like the first: one has an offset from UTC, the other "
                "has not; write all alike"
            )
        seconds[row] = _seconds(moment, zone)
        # The hour that a clock goes through twice: the second time, when it would step back.
        if zone is not None and not has_offset and row and seconds[row] <= seconds[row - 1]:
            seconds[row] = _seconds(moment.replace(fold=1), zone)
    return seconds, "utc" if has_offset or zone is not None else "local"


def zero_of(text: str, clock: Clock, zone: tzinfo | None) -> float:
    """Return the seconds since 1970 of the moment that a model's time counts from.

    Args:
        text: The timestamp of the case file.
        clock: What the recordings' times count from.
        zone: Time zone of the case, if it gives one.

    Returns:
        Seconds since 1970 on the recordings' clock.

    Raises:
        InputError: If it is no timestamp, or not on the recordings' clock.
    """
    where = f'time.zero = "{text}"'
    try:
        moment = _parsed(text)
    except ValueError:
        raise InputError(
            f'{where} is no timestamp; write for instance "2018-01-01T00:00", or "{FIRST}" for the first row'
        ) from None
    if clock == "seconds":
        raise InputError(
            f"{where}: the recordings count seconds, which have a zero; drop the key, or write "
            f'zero = "{FIRST}" to count from the first row'
        )
    if (moment.tzinfo is not None or zone is not None) != (clock == "utc"):
        has, remedy = ("an", "add one") if clock == "utc" else ("no", "drop it")
        raise InputError(f"{where}: the recordings have {has} offset from UTC; {remedy} here")
    return _seconds(moment, zone)


def zone_named(name: str | None) -> tzinfo | None:
    """Find a time zone.

    Args:
        name: Its name, e.g. "Europe/Berlin"; None for none.

    Raises:
        InputError: If there is none of this name.
    """
    try:
        return ZoneInfo(name) if name is not None else None
    except (KeyError, ValueError, OSError):
        raise InputError(
            f'timezone = "{name}" is not known; write one like "Europe/Berlin" or "Etc/GMT-1"'
        ) from None


def _parsed(text: str) -> datetime:
    match = _DAY_FIRST.fullmatch(text.strip())
    if match is None:
        return datetime.fromisoformat(text.strip())
    day, month, year, hour, minute, second = (int(part or 0) for part in match.groups())
    return datetime(year, month, day, hour, minute, second)


def _seconds(moment: datetime, zone: tzinfo | None) -> float:
    return (moment if moment.tzinfo is not None else moment.replace(tzinfo=zone or UTC)).timestamp()
