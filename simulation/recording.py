"""Recorded series in CSV files: read once, checked cell by cell, every fault named with its line."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError

TIME_COLUMN = "time_s"


@dataclass(frozen=True, eq=False)
class Recording:
    """Columns of a CSV file on an even time grid.

    Attributes:
        path: The file.
        time: Sample times, rising in even steps. Shape (m,). [s]
        columns: One series per column asked for. Shape (m,) each.
    """

    path: Path
    time: FloatArray
    columns: dict[str, FloatArray]

    @property
    def step_s(self) -> float:
        """Distance between two samples. [s]."""
        return float(self.time[1] - self.time[0])


def read_recording(path: Path, column_names: list[str], *, if_missing: str = "") -> Recording:
    """Read columns of a CSV file with a header line and the times in `time_s`.

    Args:
        path: The file.
        column_names: Columns to read beside the time.
        if_missing: What to do where there is no such file; "" for the general advice.

    Returns:
        The series.

    Raises:
        InputError: If the file, a column or a cell is missing, no number, or the time is no even rising grid.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except FileNotFoundError:
        remedy = if_missing or "put the recording there or correct `data` and `file`"
        raise InputError(f"{path}: no such file; {remedy}") from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            f"{path}: not a readable CSV file ({error}); give a comma-separated text file"
        ) from None
    if not rows or not any(cell.strip() for cell in rows[0]):
        raise InputError(f"{path}: the file is empty; the first line names the columns")
    header = [cell.strip() for cell in rows[0]]
    for name in [TIME_COLUMN, *column_names]:
        if name not in header:
            raise InputError(f"{path}: column {name} is missing; found {', '.join(header)}")
        if header.count(name) > 1:
            raise InputError(
                f"{path}: column {name} stands {header.count(name)} times in the header; keep one"
            )
    # A blank line at the end is no row; anywhere else it is a missing cell.
    while len(rows) > 1 and not any(cell.strip() for cell in rows[-1]):
        rows.pop()
    if len(rows) < 3:
        raise InputError(f"{path}: {len(rows) - 1} rows of data; a recording has at least two")
    time = _column(path, header, rows, TIME_COLUMN)
    _check_grid(path, time)
    return Recording(path, time, {name: _column(path, header, rows, name) for name in column_names})


def _column(path: Path, header: list[str], rows: list[list[str]], name: str) -> FloatArray:
    index = header.index(name)
    values = np.empty(len(rows) - 1)
    for line, row in enumerate(rows[1:], start=2):
        cell = row[index].strip() if index < len(row) else ""
        try:
            value = float(cell)
        except ValueError:
            said = f"{cell!r} is not a number" if cell else "the cell is empty"
            raise InputError(f"{path}: line {line}, column {name}: {said}; fill the gap first") from None
        if not math.isfinite(value):
            raise InputError(f"{path}: line {line}, column {name}: {cell} is not finite; fill the gap first")
        values[line - 2] = value
    return values


def _check_grid(path: Path, time: FloatArray) -> None:
    steps = np.diff(time)
    for row in np.flatnonzero(steps <= 0)[:1]:
        said = "repeats" if steps[row] == 0 else "comes before"
        raise InputError(
            f"{path}: line {row + 3}: {TIME_COLUMN} = {time[row + 1]:.12g} {said} the line above "
            f"({time[row]:.12g}); sort the rows and drop duplicates"
        )
    step = float(np.median(steps))
    for row in np.flatnonzero(np.abs(steps - step) > 1e-6 * step)[:1]:
        raise InputError(
            f"{path}: line {row + 3}: {TIME_COLUMN} goes from {time[row]:.12g} to {time[row + 1]:.12g}, "
            f"but the grid is {step:.12g} s; fill the gap or resample to an even grid"
        )
