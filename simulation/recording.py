"""Recorded series in CSV files: read once, checked cell by cell, every fault named with its line."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.csv_table import CsvTable, composed, further_header, read_table
from simulation.errors import InputError, errors_at
from simulation.foreign_file import RECORDING, read_limited
from simulation.foreign_text import quoted, shortened
from simulation.sheets import as_csv, without_sheet
from simulation.time_unit import UNITS
from simulation.timestamps import Clock, StampForm, read_timestamps, zone_named
from simulation.units import in_si
from simulation.write_gate import FOLLOW_VARIABLE

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
# With a sign of thousands, or with three decimals.
_LIKE_GROUPS = re.compile(r"[-+]?[1-9]\d{0,2}(\.\d{3})+")
# Signs of thousands, those that are spaces among them.
_GROUPS = ".,'\u2019 \u00a0\u202f"
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")


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
        first_line: Number of the line of the first sample.
        units: Units that a line after the header says, by the names of the columns.
        stamps: The times as the file writes them. Length m.
    """

    path: Path
    time: FloatArray
    columns: dict[str, FloatArray]
    clock: Clock = "seconds"
    time_column: str = TIME_COLUMN
    first_line: int = 2
    units: Mapping[str, str] = field(default_factory=dict)
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
    stamps: StampForm | None = None,
    decimal: str | None = None,
    if_missing: str = "",
    is_quoted: bool = True,
) -> Recording:
    """Read columns of a CSV file with a header line, of a sheet of a workbook, or of a Parquet file.

    Commas, semicolons or tabulators separate the cells; with the latter two, a decimal comma is read.
    Times are seconds in a column whose name ends with `_s`, `[s]` or `(s)`, another unit's where it ends with
    `[min]`, `[h]` or `[d]`, or where a line of units after the header says so; else timestamps.

    Args:
        path: The file, as "runs.xlsx#Batch 2" with the sheet of a workbook.
        column_names: Columns to read beside the time.
        time_column: Name of the time column; None for `time_s` or `time`, whichever is there.
        timezone: Where the clock of timestamps without an offset hangs, e.g. "Europe/Berlin"; None for a
            clock without summer time.
        stamps: How timestamps are written; None for the usual forms.
        decimal: Sign before the decimals of a CSV file, "," or ".", whose numbers may then have thousands
            signs; None to find it out.
        if_missing: What to do where there is no such file; "" for the general advice.
        is_quoted: Whether a message may quote what the file holds.

    Returns:
        The series.

    Raises:
        InputError: If the file or a column is missing, a cell is no number, or the times do not rise.
    """
    needed = shortened(", ".join([time_column or TIME_COLUMN, *column_names]))
    remedy = if_missing or "put the recording there or correct `data` and `file`"
    name, sheet = without_sheet(path.name)
    path = path.with_name(name)
    content = read_limited(path, RECORDING, if_missing=f"it needs the columns {needed}; {remedy}")
    with errors_at(path) if is_quoted else _unquoted(path, needed):
        asked = {name: composed(name) for name in column_names}
        wanted = time_column and composed(time_column)
        time_names = [*filter(None, (wanted, TIME_COLUMN, STAMP_COLUMN))]
        exported = as_csv(content, path, sheet, time_names, [*asked.values()])
        table = read_table(content if exported is None else exported, time_names, [*asked.values()])
        time_name = _time_column(table.header, wanted)
        cells = _cells(table, [time_name, *asked.values()])
        n_more, units = further_header(cells, time_name)
        if n_more:
            table = replace(table, rows=table.rows[n_more:], first_line=table.first_line + n_more)
            cells = _cells(table, [time_name, *asked.values()])
        reader = _Reader(table, cells)
        unit_s = _unit_of_durations(time_name, units.get(time_name))
        numbers = {name: cells[name] for name in cells if unit_s is not None or name != time_name}
        if exported is None and decimal is not None:
            reader = _Reader(table, cells | reader.without_groups(numbers, decimal))
            has_commas = False
        else:
            has_commas = table.delimiter != "," and reader.has_decimal_commas(numbers)
        clock: Clock = "seconds"
        if unit_s is not None:
            time = unit_s * reader.numbers(time_name, has_commas=has_commas)
            for row in np.flatnonzero(np.isnan(time))[:1]:
                raise InputError(f"{reader.place(row, time_name)}: the time is missing; add it")
        else:
            time, clock = read_timestamps(
                cells[time_name], zone_named(timezone), lambda row: reader.place(row, time_name), stamps
            )
        reader.check_rising(time_name, time, timezone, stamps=unit_s is None)
        columns = {name: reader.numbers(column, has_commas=has_commas) for name, column in asked.items()}
    said = {name: units.get(column, "") for name, column in asked.items()}
    said = {name: one for name, one in said.items() if one}
    written = tuple(cells[time_name])
    return Recording(path, time, columns, clock, time_name, table.first_line, said, written)


@contextmanager
def _unquoted(path: Path, needed: str) -> Iterator[None]:
    """Say of any fault of the block no more than that the file is not such a table."""
    try:
        yield
    except InputError:
        raise InputError(
            f"{path}: is no table with the columns {needed}. It lies outside the project of its case, "
            f"so nothing of it is quoted: copy it there, or set {FOLLOW_VARIABLE}=1, to read what is wrong"
        ) from None


def _unit_of_durations(name: str, said: str | None) -> float | None:
    """Return the unit of a time column, None where it has timestamps. [s].

    Args:
        name: Name of the column, which may end with its unit.
        said: What the line of units says of it, None for nothing.
    """
    named_s = next((length for end, length in _DURATIONS.items() if name.endswith(end)), None)
    unit = in_si(said) if said is not None else None
    if said is None or unit is None or unit.exponents != (("s", 1),):
        return named_s
    if named_s is not None and named_s != float(unit.factor):
        raise InputError(f"the line of units says {quoted(said)} of column {name}; correct one of the two")
    return float(unit.factor)


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


def _cells(table: CsvTable, names: list[str]) -> dict[str, list[str]]:
    """Return the cells of columns, and refuse lines whose values may stand in other columns.

    That is values beyond the last column, as of decimal commas between commas, and cells that are missing up
    to the last column in use; beyond it, spreadsheets may leave out separators of empty cells.
    """
    header, rows = table.header, table.rows
    for name in names:
        if name not in header:
            raise InputError(
                f"column {name} is missing; correct column in the case file; there are "
                f"{shortened(', '.join(header))}"
            )
        if header.count(name) > 1:
            raise InputError(f"column {name} stands {header.count(name)} times in the header; keep one")
    if len(rows) < 2:
        raise InputError(f"{('no', 'one')[len(rows)]} row of data; a recording has at least two")
    n, places = len(header), [header.index(name) for name in names]
    n_used = 1 + max(places)
    for line, row in enumerate(rows, start=table.first_line):
        if any(row[n:]):
            is_comma = table.delimiter == ","
            hint = "; decimal commas need semicolons between the columns" if is_comma else ""
            raise InputError(f"line {line} has {len(row)} cells, the header {n}; correct one of them{hint}")
        if len(row) < n_used:
            raise InputError(
                f"line {line} has {len(row)} of the {n_used} cells up to column "
                f"{shortened(header[n_used - 1])}; remove it, or complete it with an empty cell for each "
                "value that is not known"
            )
    return {name: [row[place] for row in rows] for name, place in zip(names, places, strict=True)}


@dataclass(frozen=True)
class _Reader:
    """Makes numbers of cells, and names the line of one that is none.

    Attributes:
        table: The table.
        cells: Cells of the columns in use.
    """

    table: CsvTable
    cells: Mapping[str, list[str]]

    def place(self, row: int, column: str) -> str:
        """Name a cell."""
        return f"line {self._line(row)}, column {column}"

    def _line(self, row: int) -> int:
        return row + self.table.first_line

    def numbers(self, name: str, *, has_commas: bool) -> FloatArray:
        """Return a column as numbers, NaN where a cell is empty."""
        cells = self.cells[name]
        values = np.empty(len(cells))
        for row, cell in enumerate(cells):
            try:
                if "_" in cell:
                    raise ValueError("only Python takes 1_0 for 10")
                values[row] = float(cell.replace(",", ".") if has_commas else cell)
            except ValueError:
                if cell.casefold() not in _WORDS:
                    raise InputError(
                        f"{self.place(row, name)}: {quoted(cell)} is not a number; correct it, or leave the "
                        "cell empty"
                    ) from None
                values[row] = _WORDS[cell.casefold()]
            if abs(values[row]) > _MOST:
                raise InputError(
                    f"{self.place(row, name)}: {shortened(cell)} is no measured value; leave the cell empty"
                )
        return values

    def has_decimal_commas(self, cells: Mapping[str, list[str]]) -> bool:
        """Return whether there are decimal commas; beside points they are an error, as of thousands."""

        def first(has_one: Callable[[str], object]) -> tuple[str, int, str] | None:
            every = ((name, row, cell) for name in cells for row, cell in enumerate(cells[name]))
            return next((one for one in every if has_one(one[2])), None)

        comma, point = first(_DECIMAL_COMMA.fullmatch), first(lambda cell: "." in cell)
        if comma and point:
            where = "" if point[0] == comma[0] else f" in column {point[0]}"
            lines = self._line(comma[1]), self._line(point[1])
            raise InputError(
                f"column {comma[0]} has a comma in {quoted(comma[2])} (line {lines[0]}) and there is a point "
                f"in {quoted(point[2])} (line {lines[1]}{where}); write all numbers alike, or say at "
                'the top of the case file which sign is before the decimals: decimal = "," or "."'
            )
        dotted = [(name, row, cell) for name in cells for row, cell in enumerate(cells[name]) if "." in cell]
        if self.table.delimiter == ";" and dotted and all(_LIKE_GROUPS.fullmatch(one[2]) for one in dotted):
            name, row, cell = dotted[0]
            raise InputError(
                f"{self.place(row, name)}: {quoted(cell)} may have a decimal point or a sign of thousands, "
                'as all numbers here; say at the top of the case file which: decimal = "." or ","'
            )
        return comma is not None

    def without_groups(self, cells: Mapping[str, list[str]], decimal: str) -> dict[str, list[str]]:
        """Return the cells of columns of numbers with decimal points and without signs of thousands."""
        grouped = re.compile(
            rf"([-+]?\d{{1,3}}(?:([{_GROUPS.replace(decimal, '')}])\d{{3}})(?:\2\d{{3}})*)(.*)"
        )

        def plain(name: str, row: int, cell: str) -> str:
            match = grouped.fullmatch(cell)
            whole, rest = (re.sub(rf"[{_GROUPS}]", "", match[1]), match[3]) if match else ("", cell)
            number = whole + rest.replace(decimal, ".") if decimal == "," else whole + rest
            if (rest.count(decimal) > 1 or "," in number) or (decimal == "," and "." in rest):
                raise InputError(
                    f'{self.place(row, name)}: {quoted(cell)} is not a number with decimal = "{decimal}"; '
                    "correct one of the two"
                )
            return number

        return {name: [plain(name, row, cell) for row, cell in enumerate(cells[name])] for name in cells}

    def check_rising(self, name: str, time: FloatArray, timezone: str | None, *, stamps: bool) -> None:
        """Check that times rise; they are those of the column."""
        cells = self.cells[name]
        for row in np.flatnonzero(np.diff(time) <= 0)[:1]:
            before, cell = cells[row], cells[row + 1]
            is_same = bool(time[row + 1] == time[row])
            said, hint = "repeats" if is_same else "comes before", ""
            if stamps and time[row] - time[row + 1] <= 3600.0:
                hint = "; at the end of summer time, write the offset from UTC, or a timezone into the case"
                if timezone:
                    # Of a clock in a time zone, the same time twice is a row twice.
                    never_set = "; if this clock has no summer time, remove timezone = "
                    hint = f"{never_set}{timezone!r} from the case" if before != cell else ""
            hint = hint or ", or give replicates a column each" * is_same
            column = name if name == TIME_COLUMN else f"column {name}"
            raise InputError(
                f"line {self._line(row + 1)}: {column} = {shortened(cell)} {said} the line above "
                f"({shortened(before)}); sort the rows and drop duplicates{hint}"
            )
