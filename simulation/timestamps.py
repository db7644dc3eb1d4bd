"""Timestamps as text: what moment each means, and the traps of clocks that are set forward and back."""

import re
from datetime import UTC, datetime, tzinfo
from pathlib import Path
from typing import Final, Literal
from zoneinfo import ZoneInfo

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.foreign_text import quoted

Clock = Literal["seconds", "local", "utc"]

_EPOCH: Final = datetime(1970, 1, 1)
# Day first: with points no other order is in use.
_DAY_FIRST = re.compile(r"(\d{1,2})\.(\d{1,2})\.(\d{4})[ T]+(\d{1,2}):(\d{2})(?::(\d{2}))?")


class Timestamps:
    """Reads a column of timestamps; without offset and time zone, they are a clock that is never shifted."""

    def __init__(self, path: Path, column: str, timezone: str | None) -> None:
        """Prepare to read.

        Args:
            path: The file, for messages.
            column: The column, for messages.
            timezone: Name of the time zone of timestamps without an offset, e.g. "Europe/Berlin".

        Raises:
            InputError: If there is no such time zone.
        """
        self._path, self._column = path, column
        self._zone = zone_named(timezone, str(path)) if timezone else None

    def read(self, cells: list[str], *, first_line: int) -> tuple[FloatArray, Clock]:
        """Return the moments and what they count from.

        Args:
            cells: The timestamps.
            first_line: Line of the first one in the file, for messages.

        Returns:
            Seconds since 1970, shape (m,), in UTC or on the local clock.

        Raises:
            InputError: If one is no timestamp, or some have an offset and some have not.
        """
        moments = [self._parsed(cell, line) for line, cell in enumerate(cells, start=first_line)]
        has_offset = moments[0].tzinfo is not None
        seconds = np.empty(len(moments))
        for row, moment in enumerate(moments):
            if (moment.tzinfo is not None) != has_offset:
                raise InputError(
                    f"{self._path}: line {row + first_line}, column {self._column}: {cells[row]} is not "
                    "written like the first: one has an offset from UTC, the other has not; write all alike"
                )
            seconds[row] = _seconds(moment, self._zone)
            # The hour that a clock goes through twice: the second time, when it would step back.
            if self._zone is not None and not has_offset and row and seconds[row] <= seconds[row - 1]:
                seconds[row] = _seconds(moment.replace(fold=1), self._zone)
        return seconds, "utc" if has_offset or self._zone is not None else "local"

    def _parsed(self, cell: str, line: int) -> datetime:
        try:
            return parsed(cell)
        except ValueError:
            where = f"{self._path}: line {line}, column {self._column}"
            if not cell.strip():
                raise InputError(f"{where}: the time is missing; add it, or remove the line") from None
            raise InputError(
                f"{where}: {quoted(cell)} is no timestamp; write 2018-02-21T00:30:00+01:00 or 21.02.2018 "
                "00:30, or seconds in a column time_s, or a unit in its name, as in time [h]"
            ) from None


def parsed(text: str) -> datetime:
    """Read one timestamp: ISO 8601, or day.month.year hour:minute.

    Args:
        text: The timestamp.

    Returns:
        The moment, with its offset from UTC if the text has one.

    Raises:
        ValueError: If it is neither.
    """
    match = _DAY_FIRST.fullmatch(text.strip())
    if match is None:
        return datetime.fromisoformat(text.strip())
    day, month, year, hour, minute = (int(part) for part in match.groups()[:5])
    return datetime(year, month, day, hour, minute, int(match[6] or 0))


def zero_of(text: str, clock: Clock, timezone: str | None, where: str) -> float:
    """Return the seconds since 1970 of the moment that a model's time counts from.

    Args:
        text: The timestamp of the case file.
        clock: What the recordings' times count from.
        timezone: Time zone of the case, if it gives one.
        where: Key of the case file, for messages.

    Returns:
        Seconds since 1970 on the recordings' clock.

    Raises:
        InputError: If it is no timestamp, or not on the recordings' clock.
    """
    try:
        moment = parsed(text)
    except ValueError:
        raise InputError(
            f'{where} = "{text}" is no timestamp; write for instance "2018-01-01T00:00"'
        ) from None
    zone = zone_named(timezone, where) if timezone else None
    if clock == "seconds":
        raise InputError(f'{where} = "{text}": the recordings count seconds, which have a zero; drop the key')
    if (moment.tzinfo is not None or zone is not None) != (clock == "utc"):
        has, remedy = ("an", "add one") if clock == "utc" else ("no", "drop it")
        raise InputError(f'{where} = "{text}": the recordings have {has} offset from UTC; {remedy} here')
    return _seconds(moment, zone)


def zone_named(name: str, where: str) -> tzinfo:
    """Find a time zone.

    Args:
        name: Its name, e.g. "Europe/Berlin".
        where: What asks for it, for messages.

    Raises:
        InputError: If there is none of this name.
    """
    try:
        return ZoneInfo(name)
    except (KeyError, ValueError, OSError):
        raise InputError(
            f'{where}: timezone = "{name}" is not known; write one like "Europe/Berlin" or "Etc/GMT-1"'
        ) from None


def _seconds(moment: datetime, zone: tzinfo | None) -> float:
    if moment.tzinfo is None and zone is not None:
        moment = moment.replace(tzinfo=zone)
    if moment.tzinfo is None:
        return (moment - _EPOCH).total_seconds()
    return (moment - _EPOCH.replace(tzinfo=UTC)).total_seconds()
