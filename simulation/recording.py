"""Recorded series in CSV files: read once, checked cell by cell, every fault named with its line."""

import csv
import io
import math
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.foreign_file import RECORDING, read_limited
from simulation.foreign_text import quoted, shortened
from simulation.time_unit import UNITS
from simulation.timestamps import Clock, Timestamps

TIME_COLUMN: Final = "time_s"
STAMP_COLUMN: Final = "time"
# Cells that are no numbers and yet have a meaning: nothing was measured, or a switch.
_WORDS: Final = dict.fromkeys(("", "nan", "na", "n/a", "null", "none"), math.nan) | {
    "true": 1.0,
    "false": 0.0,
}
# Beyond, programs mark what was not measured; squares of it are no numbers any more.
_MOST: Final = 1e30
# What the name of a column of durations ends with, and how long its unit is. [s]
_DURATIONS: Final = {"_s": 1.0} | {
    f"{left}{unit.symbol}{right}": unit.seconds for unit in UNITS.values() for left, right in ("[]", "()")
}
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
FIRST_LINE: Final = 2


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
    """

    path: Path
    time: FloatArray
    columns: dict[str, FloatArray]
    clock: Clock = "seconds"
    time_column: str = TIME_COLUMN

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
    remedy = if_missing or "put the recording there or correct `data` and `file`"
    needed = ", ".join([time_column or TIME_COLUMN, *column_names])
    content = read_limited(path, RECORDING, if_missing=f"it needs the columns {shortened(needed)}; {remedy}")
    rows, delimiter = _rows(path, content)
    if not rows or not any(cell.strip() for cell in rows[0]):
        raise InputError(f"{path}: the file is empty; the first line names the columns")
    # An umlaut may be one character or two.
    header = [_composed(cell.strip()) for cell in rows[0]]
    asked = {name: _composed(name) for name in column_names}
    time_name = _time_column(path, header, time_column and _composed(time_column))
    for name in (time_name, *asked.values()):
        if name not in header:
            raise InputError(
                f"{path}: column {name} is missing; correct column in the case file; there are "
                f"{shortened(', '.join(header))}"
            )
        if header.count(name) > 1:
            raise InputError(
                f"{path}: column {name} stands {header.count(name)} times in the header; keep one"
            )
    # A blank line at the end is no row; anywhere else its time is missing.
    while len(rows) > 1 and not any(cell.strip() for cell in rows[-1]):
        rows.pop()
    if len(rows) < 3:
        n_rows = "one row" if len(rows) == 2 else "no row"
        raise InputError(f"{path}: {n_rows} of data; a recording has at least two")
    n_used = 1 + max(header.index(name) for name in (time_name, *asked.values()))
    _check_lengths(path, rows, n_used, delimiter)
    cells = {name: _cells(rows, header.index(name)) for name in (time_name, *asked.values())}
    unit_s = next((length for end, length in _DURATIONS.items() if time_name.endswith(end)), None)
    numbers = {name: cells[name] for name in cells if unit_s is not None or name != time_name}
    has_commas = delimiter != "," and _has_decimal_commas(path, numbers)
    clock: Clock = "seconds"
    if unit_s is not None:
        time = unit_s * _numbers(path, time_name, cells[time_name], has_commas=has_commas)
        for row in np.flatnonzero(np.isnan(time))[:1]:
            raise InputError(
                f"{path}: line {row + FIRST_LINE}, column {time_name}: the time is missing; add it"
            )
    else:
        stamps = Timestamps(path, time_name, timezone)
        time, clock = stamps.read(cells[time_name], first_line=FIRST_LINE)
    _check_rising(path, time_name, time, cells[time_name], timezone)
    columns = {
        name: _numbers(path, column, cells[column], has_commas=has_commas) for name, column in asked.items()
    }
    return Recording(path, time, columns, clock, time_name)


def _rows(path: Path, content: bytes) -> tuple[list[list[str]], str]:
    """Return the cells of all lines, and what separates them."""
    try:
        if content.startswith(b"PK\x03\x04"):
            raise InputError(f"{path}: is a workbook, no CSV file; save its sheet as CSV")
        text = _decoded(content)
        first = text.partition("\n")[0]
        bare = re.sub('"[^"]*"', "", first)
        delimiter = next((sign for sign in ";\t" if sign in bare), ",")
        if first.startswith("sep="):
            raise InputError(
                f"{path}: line 1, {quoted(first.strip())}, is for a spreadsheet alone; remove it"
            )
        return list(csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)), delimiter
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            f"{path}: not a readable CSV file ({error}); give a comma-separated text file"
        ) from None


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


def _time_column(path: Path, header: list[str], asked: str | None) -> str:
    if asked is not None and asked in header:
        return asked
    for name in (TIME_COLUMN, STAMP_COLUMN):
        if name in header:
            return name
    wanted = (
        f"time column {asked} is missing" if asked else f"no column {TIME_COLUMN} or {STAMP_COLUMN} is there"
    )
    raise InputError(
        f"{path}: {wanted}; found {shortened(', '.join(header))}; name it with time_column in the case file"
    )


def _check_lengths(path: Path, rows: list[list[str]], n_used: int, delimiter: str) -> None:
    """Refuse lines whose values may stand in other columns than those that they are of.

    That is values beyond the last column, as of decimal commas between commas, and cells that are missing up
    to the last column in use; beyond it, spreadsheets may leave out separators of empty cells.
    """
    n = len(rows[0])
    for line, row in enumerate(rows, start=1):
        if len(row) > n and any(cell.strip() for cell in row[n:]):
            hint = "; decimal commas need semicolons between the columns" if delimiter == "," else ""
            raise InputError(
                f"{path}: line {line} has {len(row)} cells, the header {n}; correct one of them{hint}"
            )
        if len(row) < n_used:
            raise InputError(
                f"{path}: line {line} has {len(row)} of the {n_used} cells up to column "
                f"{shortened(rows[0][n_used - 1].strip())}; remove it, or complete it with an empty cell for "
                "each value that is not known"
            )


def _cells(rows: list[list[str]], index: int) -> list[str]:
    return [row[index].strip() for row in rows[1:]]


def _numbers(path: Path, name: str, cells: list[str], *, has_commas: bool) -> FloatArray:
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
                    f"{path}: line {row + FIRST_LINE}, column {name}: {quoted(cell)} is not a number; "
                    "correct it, or leave the cell empty"
                ) from None
            values[row] = _WORDS[cell.casefold()]
        if abs(values[row]) > _MOST:
            raise InputError(
                f"{path}: line {row + FIRST_LINE}, column {name}: {shortened(cell)} is no measured value; "
                "leave the cell empty"
            )
    return values


def _has_decimal_commas(path: Path, cells: Mapping[str, list[str]]) -> bool:
    """Say whether a file has decimal commas; where it has points as well, one of them may mean thousands."""
    commas, points = (
        next(
            (
                (name, row)
                for name, column in cells.items()
                for row, cell in enumerate(column)
                if is_one(cell)
            ),
            None,
        )
        for is_one in (_DECIMAL_COMMA.fullmatch, lambda cell: "." in cell)
    )
    if commas and points:
        (comma, row_of_comma), (point, row_of_point) = commas, points
        where = "" if point == comma else f" in column {point}"
        raise InputError(
            f"{path}: column {comma} has a comma in {quoted(cells[comma][row_of_comma])} (line "
            f"{row_of_comma + FIRST_LINE}) and there is a point in {quoted(cells[point][row_of_point])} "
            f"(line {row_of_point + FIRST_LINE}{where}); write all numbers alike, without thousands signs"
        )
    return commas is not None


def _check_rising(path: Path, name: str, time: FloatArray, cells: list[str], timezone: str | None) -> None:
    for row in np.flatnonzero(np.diff(time) <= 0)[:1]:
        said = "repeats" if time[row + 1] == time[row] else "comes before"
        stamps = name if name == TIME_COLUMN else f"column {name}"
        hint = ""
        if not name.endswith(tuple(_DURATIONS)) and 0 <= time[row] - time[row + 1] <= 3600.0:
            never_set = (
                f"; if this clock is never set forward or back, remove timezone = {timezone!r} from the case"
            )
            hint = (
                # Of a clock in a time zone, the same time twice is a row twice.
                never_set * (cells[row] != cells[row + 1])
                if timezone
                else "; if clocks were set back there, write the offset from UTC, or give the case a timezone"
            )
        raise InputError(
            f"{path}: line {row + FIRST_LINE + 1}: {stamps} = {shortened(cells[row + 1])} {said} the line "
            f"above ({shortened(cells[row])}); sort the rows and drop duplicates{hint}"
        )
