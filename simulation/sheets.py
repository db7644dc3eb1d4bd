"""Sheets of workbooks and Parquet files as the CSV files that they would be exported to."""

import csv
import io
import os
import zipfile
from collections.abc import Collection
from datetime import datetime
from pathlib import Path
from typing import Any

from simulation.csv_table import names_of
from simulation.errors import InputError
from simulation.foreign_file import UNPACKED, check_members
from simulation.foreign_text import quoted, shortened

_OTHERS = {
    b"\xd0\xcf\x11\xe0": "a workbook of an old form",
    b"MATLAB 5.0": "a MATLAB file",
    b"\x89HDF\r\n": "an HDF5 file",
}
"""Tables of other kinds, by how they begin."""
_OF_SHEET = ".xlsx#"
INSTALL = "pip install 'pelsvae-studies[excel]'"


def without_sheet(name: str) -> tuple[str, str]:
    """Take the name of a sheet off the name of a file, as of "runs.xlsx#Batch 2"; "" where there is none."""
    at = name.lower().find(_OF_SHEET)
    return (name, "") if at < 0 else (name[: at + len(_OF_SHEET) - 1], name[at + len(_OF_SHEET) :])


def real_path(path: Path) -> Path:
    """Return where a recording lies, links followed, with the name of its sheet."""
    name, sheet = without_sheet(path.name)
    found = Path(os.path.realpath(path.with_name(name)))
    return found.with_name(f"{found.name}#{sheet}") if sheet else found


def as_csv(
    content: bytes, path: Path, sheet: str, time_names: Collection[str], names: Collection[str]
) -> bytes | None:
    """Return a table as a CSV file with commas, decimal points and ISO timestamps, line by line the same.

    Args:
        content: The file.
        path: Its name, for messages.
        sheet: The sheet of a workbook; "" for the only one that has the columns.
        time_names: Names that a time column may have.
        names: The other columns.

    Returns:
        The CSV file; None of a file that is neither a workbook nor Parquet.

    Raises:
        InputError: If it cannot be read, is too large, or it is not clear which sheet is meant.
    """
    if content.startswith(b"PK\x03\x04"):
        return _written(_sheet_rows(content, path, sheet, {*time_names}, {*names}))
    if content.startswith(b"PAR1"):
        return _written(_parquet_rows(content))
    for begin, what in _OTHERS.items():
        if content.startswith(begin):
            raise InputError(f"is {what}; save its table as CSV, .xlsx or Parquet")
    return None


def _sheet_rows(
    content: bytes, path: Path, sheet: str, time_names: set[str], names: set[str]
) -> list[list[Any]]:
    import pandas as pd

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile) as error:
        raise InputError(f"is no readable workbook ({error}); save it again") from None
    check_members(members, "the workbook")
    try:
        found = pd.read_excel(
            io.BytesIO(content),
            sheet_name=None,
            header=None,
            dtype=object,
            na_filter=False,
            engine="openpyxl",
        )
    except ImportError:
        raise InputError(
            f"is a workbook, which needs openpyxl: {INSTALL}; or save its sheet as CSV"
        ) from None
    except Exception as error:  # openpyxl raises whatever a damaged file leads to
        raise InputError(f"is no readable workbook ({shortened(str(error))}); save it again") from None
    sheets = {str(name): frame.to_numpy(dtype=object).tolist() for name, frame in found.items()}
    if sheet and sheet not in sheets:
        raise InputError(f"has no sheet {quoted(sheet)}; it has {shortened(', '.join(sheets))}")
    fitting = [
        name for name, rows in sheets.items() if any(_is_header(row, time_names, names) for row in rows[:200])
    ]
    if not sheet and len(fitting) > 1:
        raise InputError(
            f"has the columns in several sheets, {shortened(', '.join(fitting))}; say which: "
            f'file = "{path.name}#{fitting[0]}"'
        )
    if not sheet and not fitting and len(sheets) > 1:
        raise InputError(
            f"no sheet has all columns, {shortened(', '.join(sorted(names)))} and a time column; say in each "
            f'file = "{path.name}#..." which sheet: {shortened(", ".join(sheets))}'
        )
    return sheets[sheet or next(iter(fitting or sheets))]


def _is_header(row: list[Any], time_names: set[str], names: set[str]) -> bool:
    found = names_of([_text(cell) for cell in row])
    return bool(time_names & found) and names <= found


def _parquet_rows(content: bytes) -> list[list[Any]]:
    import pandas as pd
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    try:
        said = ParquetFile(io.BytesIO(content)).metadata
        UNPACKED.check(said.num_rows * said.num_columns * 8 / 1e6, "the table")
        frame = pd.read_parquet(io.BytesIO(content))
    except (ArrowException, OSError, ValueError) as error:
        raise InputError(f"is no readable Parquet file ({shortened(str(error))}); write it again") from None
    if not isinstance(frame.index, pd.RangeIndex):
        # An index without a name is the time of a series.
        frame = frame.reset_index(names=[str(name or "time") for name in frame.index.names])
    return [list(frame.columns), *frame.astype(object).to_numpy().tolist()]


def _written(rows: list[list[Any]]) -> bytes:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows([[_text(cell) for cell in row] for row in rows])
    return text.getvalue().encode()


def _text(cell: Any) -> str:
    """Write a cell as a CSV file has it; what was not measured is empty."""
    if isinstance(cell, bool):
        return str(cell).lower()
    if isinstance(cell, datetime):
        # Fractions of days are moments but for some microseconds.
        return "" if cell != cell else cell.isoformat(sep=" ", timespec="milliseconds")
    if isinstance(cell, float):
        return "" if cell != cell else repr(cell)
    return "" if cell is None else " ".join(str(cell).split())
