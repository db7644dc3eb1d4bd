"""Timestamps as text: what moment each means, and the traps of clocks that are set forward and back."""

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, tzinfo
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


# The end of a day, as the end of its last interval is written.
_MIDNIGHT = re.compile(r"(?<![\d:])24:00(?=(:00(\.0+)?)?(?![\d:]))")
# A code of strptime for a year, not an escaped percent sign.
_YEAR_CODE = re.compile(r"(?<!%)(?:%%)*%[yYcxG]")
# With a slash it may be the day or the month that comes first.
_SLASHES = re.compile(
    r"\d{1,2}/\d{1,2}(?P<year>/\d{2,4})?"
    r"(?P<time>[ T]+\d{1,2}:\d{2}(?P<second>:\d{2})?(?P<half>\s*[AaPp][Mm])?)?"
)
# With the year first it is clear.
_YEAR_FIRST = re.compile(r"(\d{4})/(\d{1,2})/(\d{1,2})(?=$|[ T])")
_LEAST_STEP_BACK_D = 300
"""A step back of more days is a new year: a recording has no gap of two months over it."""
_USUAL_YEAR = 2001
"""Of timestamps without one: a year of 365 days, as simulation programs have it."""


@dataclass(frozen=True)
class StampForm:
    """How timestamps are written that no usual form fits.

    Attributes:
        text: Codes of Python's strptime, as "%m/%d/%Y %H:%M".
        year: Year of timestamps that have none.
    """

    text: str
    year: int = _USUAL_YEAR

    @property
    def has_year(self) -> bool:
        """Whether the timestamps have a year themselves."""
        return _YEAR_CODE.search(self.text) is not None

    def parse(self, cell: str) -> datetime:
        """Return the moment of a timestamp; ValueError where it is written in another way."""
        if self.has_year:
            return datetime.strptime(cell, self.text)
        return datetime.strptime(f"{self.year} {cell}", f"%Y {self.text}")

    def check(self) -> None:
        """Check that its codes say a day.

        Raises:
            ValueError: If they do not.
        """
        day = datetime(self.year, 3, 14)
        try:
            is_same = self.parse(day.strftime(self.text)).replace(tzinfo=None) == day
        except ValueError:
            is_same = False
        if not is_same:
            raise ValueError('has no day; write codes of strptime, like "%m/%d/%Y %H:%M"')


def read_timestamps(
    cells: Sequence[str], zone: tzinfo | None, where: Callable[[int], str], form: StampForm | None = None
) -> tuple[FloatArray, Clock]:
    """Return the moments of a column and what they count from.

    Args:
        cells: The timestamps: ISO 8601, or day.month.year hour:minute; the end of a day may be its 24:00.
        zone: Where the clock of timestamps without an offset hangs; None for one that is never set.
        where: Names the place of a cell by its number, for messages.
        form: How they are written instead. Without a year they go on into the next one after December.

    Returns:
        Seconds since 1970, shape (m,), in UTC or on the local clock.

    Raises:
        InputError: If one is no timestamp, or some have an offset and some have not.
    """
    seconds, has_offset, before = np.empty(len(cells)), False, None
    for row, cell in enumerate(cells):
        if not cell:
            raise InputError(f"{where(row)}: the time is missing; add it, or remove the line")
        try:
            moment = _parsed(cell, form)
        except ValueError:
            raise InputError(f"{where(row)}: {quoted(cell)} {_remedy(cell, form)}") from None
        has_offset = has_offset if row else moment.tzinfo is not None
        if (moment.tzinfo is not None) != has_offset:
            raise InputError(
                f"{where(row)}: {cell} is not written like the first: one has an offset from UTC, the other "
                "has not; write all alike"
            )
        if form is not None and not form.has_year:
            if before is not None and (before - moment).days > _LEAST_STEP_BACK_D:
                form = replace(form, year=form.year + 1)
                moment = _parsed(cell, form)
            before = moment
        seconds[row] = _seconds(moment, zone)
        # The hour that a clock goes through twice: the second time, when it would step back.
        if zone is not None and not has_offset and row and seconds[row] <= seconds[row - 1]:
            seconds[row] = _seconds(moment.replace(fold=1), zone)
    return seconds, "utc" if has_offset or zone is not None else "local"


def zero_of(text: str, clock: Clock, zone: tzinfo | None, form: StampForm | None = None) -> float:
    """Return the seconds since 1970 of the moment that a model's time counts from.

    Args:
        text: The timestamp of the case file.
        clock: What the recordings' times count from.
        zone: Time zone of the case, if it gives one.
        form: How its recordings write timestamps, if not in the usual forms; its zero may be written alike.

    Returns:
        Seconds since 1970 on the recordings' clock.

    Raises:
        InputError: If it is no timestamp, or not on the recordings' clock.
    """
    where = f'time.zero = "{text}"'
    try:
        moment = _of_either_form(text, form)
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


def _remedy(cell: str, form: StampForm | None) -> str:
    """Say what is wrong with a cell that is no timestamp, and what to do."""
    if form is not None:
        hint = "" if form.has_year else f", or is no day of {form.year} (year = ... names another)"
        return f'is not written like time_format = "{form.text}"{hint}; correct one of the two'
    slashes = _SLASHES.fullmatch(cell)
    if slashes is not None:
        year = "/%y" if len(slashes["year"] or "") == 3 else "/%Y" * bool(slashes["year"])
        clock = ("%I" if slashes["half"] else "%H") + ":%M" + ":%S" * bool(slashes["second"])
        rest = year + f" {clock}{' %p' * bool(slashes['half'])}" * bool(slashes["time"])
        return (
            "may have the month or the day first; say at the top of the case file which: "
            f'time_format = "%m/%d{rest}" or "%d/%m{rest}"'
        )
    return (
        "is no timestamp; write 2018-02-21T00:30:00+01:00 or 21.02.2018 00:30, or say time_format in the "
        "case file; or write seconds in a column time_s, or a unit in its name, as in time [h]"
    )


def _of_either_form(text: str, form: StampForm | None) -> datetime:
    """Return the moment of a timestamp that is written in a form of its own or in a usual one."""
    if form is not None:
        with suppress(ValueError):
            return _parsed(text, form)
    return _parsed(text)


def _parsed(text: str, form: StampForm | None = None) -> datetime:
    # The hour 24 is the next day's first; strptime and fromisoformat do not know it.
    text, n_ends = _MIDNIGHT.subn("00:00", text.strip())
    match = _DAY_FIRST.fullmatch(text)
    if form is not None:
        moment = form.parse(text)
    elif match is None:
        moment = datetime.fromisoformat(_YEAR_FIRST.sub(_dashed, text))
    else:
        day, month, year, hour, minute, second = (int(part or 0) for part in match.groups())
        moment = datetime(year, month, day, hour, minute, second)
    return moment + timedelta(days=n_ends)


def _dashed(day: re.Match[str]) -> str:
    return f"{day[1]}-{int(day[2]):02d}-{int(day[3]):02d}"


def _seconds(moment: datetime, zone: tzinfo | None) -> float:
    return (moment if moment.tzinfo is not None else moment.replace(tzinfo=zone or UTC)).timestamp()
