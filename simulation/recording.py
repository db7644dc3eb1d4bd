"""Recorded series in CSV files: read once, checked cell by cell, every fault named with its line."""

import csv
import io
import math
import re
import unicodedata
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError, errors_at
from simulation.foreign_file import RECORDING, read_limited
from simulation.foreign_text import quoted, shortened
from simulation.time_unit import UNITS
from simulation.timestamps import Clock, read_timestamps, zone_named

TIME_COLUMN = "time_s"
STAMP_COLUMN = "time"
# Cells that are no numbers and yet have a meaning: nothing was measured, or a switch.
_WORDS = dict.fromkeys(("", "nan", "na", "n/a", "null", "none"), math.nan) | {
    "true": 1.0,
    "false": 0.0,
}
# Beyond, programs mark what was not measured; squares of it are no numbers any more.
_MOST = 1e30
# What the name of a column of durations ends with, and how long its unit is. [s]
_DURATIONS = {"_s": 1.0} | {
    f"{left}{unit.symbol}{right}": unit.seconds for unit in UNITS.values() for left, right in ("[]", "()")
}
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
FIRST_LINE = 2


@dataclass(frozen=True, eq=False)
class Recording:
    """Columns of a CSV file over rising times.

    Attributes:
        path: The file.
        time: Sample times, rising. Shape (m,). [s]
        columns: One series per column asked for, NaN where a cell is empty. Shape (m,) each.
        clock: What the times count from: "seconds" as the file says, "local" a clock without time zone,
            "utc" timestamps with one; the last two in seconds since 1970.
        time_column: Column that the times were read from.
        stamps: The times as the file writes them. Length m.
    """

    path: Path
    time: FloatArray
    columns: dict[str, FloatArray]
    clock: Clock = "seconds"
    time_column: str = TIME_COLUMN
    stamps: tuple[str, ...] = ()

    @property
    def step_s(self) -> float:
        """Usual distance between two samples, the median. [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def is_even(self) -> bool:
        """Whether all samples lie equally far apart."""
        return bool(np.all(np.abs(np.diff(self.time) - self.step_s) <= 1e-6 * self.step_s))

    def since(self, zero_s: float) -> "Recording":
        """Return the same series with times that count from another zero. [s]."""
        return replace(self, time=self.time - zero_s)


def read_recording(
    path: Path,
    column_names: list[str],
    *,
    time_column: str | None = None,
    timezone: str | None = None,
    if_missing: str = "",
) -> Recording:
    """Read columns of a CSV file with a header line.

    Commas, semicolons or tabulators separate the cells; with the latter two, a decimal comma is read.
    Times are seconds in a column whose name ends with `_s`, `[s]` or `(s)`, another unit's where it ends with
    `[min]`, `[h]` or `[d]`, else timestamps.

    Args:
        path: The file.
        column_names: Columns to read beside the time.
        time_column: Name of the time column; None for `time_s` or `time`, whichever is there.
        timezone: Where the clock of timestamps without an offset hangs, e.g. "Europe/Berlin"; None for a
            clock that is never set forward or back.
        if_missing: What to do where there is no such file; "" for the general advice.

    Returns:
        The series.

    Raises:
        InputError: If the file or a column is missing, a cell is no number, or the times do not rise.
    """
    needed = shortened(", ".join([time_column or TIME_COLUMN, *column_names]))
    remedy = if_missing or "put the recording there or correct `data` and `file`"
    content = read_limited(path, RECORDING, if_missing=f"it needs the columns {needed}; {remedy}")
    with errors_at(path):
        rows, delimiter = _rows(content)
        # An umlaut may be one character or two.
        header = [_composed(cell) for cell in rows[0]]
        asked = {name: _composed(name) for name in column_names}
        time_name = _time_column(header, time_column and _composed(time_column))
        cells = _cells(rows, header, [time_name, *asked.values()], delimiter)
        unit_s = next((length for end, length in _DURATIONS.items() if time_name.endswith(end)), None)
        numbers = {name: cells[name] for name in cells if unit_s is not None or name != time_name}
        has_commas = delimiter != "," and _has_decimal_commas(numbers)
        clock: Clock = "seconds"
        if unit_s is not None:
            time = unit_s * _numbers(time_name, cells[time_name], has_commas=has_commas)
            for row in np.flatnonzero(np.isnan(time))[:1]:
                raise InputError(f"{_place(row, time_name)}: the time is missing; add it")
        else:
            time, clock = read_timestamps(
                cells[time_name], zone_named(timezone), lambda row: _place(row, time_name)
            )
        _check_rising(time_name, time, cells[time_name], timezone, stamps=unit_s is None)
        columns = {
            name: _numbers(column, cells[column], has_commas=has_commas) for name, column in asked.items()
        }
    return Recording(path, time, columns, clock, time_name, tuple(cells[time_name]))


def _place(row: int, column: str) -> str:
    return f"line {row + FIRST_LINE}, column {column}"


def _rows(content: bytes) -> tuple[list[list[str]], str]:
    """Return the cells of all lines, without blanks around them, and what separates them."""
    if content.startswith(b"PK\x03\x04"):
        raise InputError("is a workbook, no CSV file; save its sheet as CSV")
    try:
        text = _decoded(content)
        first = text.partition("\n")[0]
        if first.startswith("sep="):
            raise InputError(f"line 1, {quoted(first.strip())}, is for a spreadsheet alone; remove it")
        bare = re.sub('"[^"]*"', "", first)
        delimiter = next((sign for sign in ";\t" if sign in bare), ",")
        lines = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        rows = [[cell.strip() for cell in line] for line in lines]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"not a readable CSV file ({error}); give a comma-separated text file") from None
    if not rows or not any(rows[0]):
        raise InputError("the file is empty; the first line names the columns")
    # A blank line at the end is no row; anywhere else its time is missing.
    while not any(rows[-1]):
        rows.pop()
    return rows, delimiter


def _composed(name: str) -> str:
    return unicodedata.normalize("NFC", name)


def _decoded(content: bytes) -> str:
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # The usual encoding of a spreadsheet's export; its umlauts and degree signs can only be in names.
        return content.decode("cp1252")


def _time_column(header: list[str], asked: str | None) -> str:
    found = next((name for name in (asked, TIME_COLUMN, STAMP_COLUMN) if name in header), None)
    if found is not None:
        return found
    wanted = (
        f"time column {asked} is missing" if asked else f"no column {TIME_COLUMN} or {STAMP_COLUMN} is there"
    )
    raise InputError(
        f"{wanted}; found {shortened(', '.join(header))}; name it with time_column in the case file"
    )


def _cells(
    rows: list[list[str]], header: list[str], names: list[str], delimiter: str
) -> dict[str, list[str]]:
    """Return the cells of columns, and refuse lines whose values may stand in other columns.

    That is values beyond the last column, as of decimal commas between commas, and cells that are missing up
    to the last column in use; beyond it, spreadsheets may leave out separators of empty cells.
    """
    for name in names:
        if name not in header:
            raise InputError(
                f"column {name} is missing; correct column in the case file; there are "
                f"{shortened(', '.join(header))}"
            )
        if header.count(name) > 1:
            raise InputError(f"column {name} stands {header.count(name)} times in the header; keep one")
    if len(rows) < 3:
        raise InputError(f"{('no', 'one')[len(rows) - 1]} row of data; a recording has at least two")
    n, places = len(header), [header.index(name) for name in names]
    n_used = 1 + max(places)
    for line, row in enumerate(rows, start=1):
        if any(row[n:]):
            hint = "; decimal commas need semicolons between the columns" if delimiter == "," else ""
            raise InputError(f"line {line} has {len(row)} cells, the header {n}; correct one of them{hint}")
        if len(row) < n_used:
            raise InputError(
                f"line {line} has {len(row)} of the {n_used} cells up to column "
                f"{shortened(header[n_used - 1])}; remove it, or complete it with an empty cell for each "
                "value that is not known"
            )
    return {name: [row[place] for row in rows[1:]] for name, place in zip(names, places, strict=True)}


def _numbers(name: str, cells: list[str], *, has_commas: bool) -> FloatArray:
    """Return the cells as numbers, NaN where one is empty."""
    values = np.empty(len(cells))
    for row, cell in enumerate(cells):
        try:
            if "_" in cell:
                raise ValueError("only Python takes 1_0 for 10")
            values[row] = float(cell.replace(",", ".") if has_commas else cell)
        except ValueError:
            if cell.casefold() not in _WORDS:
                raise InputError(
                    f"{_place(row, name)}: {quoted(cell)} is not a number; correct it, or leave the cell "
                    "empty"
                ) from None
            values[row] = _WORDS[cell.casefold()]
        if abs(values[row]) > _MOST:
            raise InputError(
                f"{_place(row, name)}: {shortened(cell)} is no measured value; leave the cell empty"
            )
    return values


def _has_decimal_commas(cells: Mapping[str, list[str]]) -> bool:
    """Return whether there are decimal commas; beside points they are an error: one may mean thousands."""

    def first(has_one: Callable[[str], object]) -> tuple[str, int, str] | None:
        every = ((name, row, cell) for name in cells for row, cell in enumerate(cells[name]))
        return next((one for one in every if has_one(one[2])), None)

    comma, point = first(_DECIMAL_COMMA.fullmatch), first(lambda cell: "." in cell)
    if comma and point:
        where = "" if point[0] == comma[0] else f" in column {point[0]}"
        raise InputError(
            f"column {comma[0]} has a comma in {quoted(comma[2])} (line {comma[1] + FIRST_LINE}) and there "
            f"is a point in {quoted(point[2])} (line {point[1] + FIRST_LINE}{where}); write all numbers "
            "alike, without thousands signs"
        )
    return comma is not None


def _check_rising(
    name: str, time: FloatArray, cells: list[str], timezone: str | None, *, stamps: bool
) -> None:
    for row in np.flatnonzero(np.diff(time) <= 0)[:1]:
        before, cell = cells[row], cells[row + 1]
        said = "repeats" if time[row + 1] == time[row] else "comes before"
        hint = ""
        if stamps and time[row] - time[row + 1] <= 3600.0:
            hint = "; if clocks were set back there, write the offset from UTC, or give the case a timezone"
            if timezone:
                # Of a clock in a time zone, the same time twice is a row twice.
                never_set = "; if this clock is never set forward or back, remove timezone = "
                hint = f"{never_set}{timezone!r} from the case" if before != cell else ""
        column = name if name == TIME_COLUMN else f"column {name}"
        raise InputError(
            f"line {row + FIRST_LINE + 1}: {column} = {shortened(cell)} {said} the line above "
            f"({shortened(before)}); sort the rows and drop duplicates{hint}"
        )
