"""CSV files as programs export them: which separator, where the header stands, whether units follow it."""

import csv
import io
import re
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice

from simulation.errors import InputError
from simulation.foreign_text import quoted
from simulation.units import in_si

COMMENTS = ("#", "%", "//", "!")
"""What lines that are no data begin with, as loggers and numerical programs write them."""
_MOST_BEFORE = 200
"""Lines in which a header is looked for; loggers write some ten before it."""
_MOST_AFTER = 3
"""Lines after the names: loggers write units, kinds of samples, descriptions."""


@dataclass(frozen=True)
class CsvTable:
    """The cells of a CSV file, without blanks around them.

    Attributes:
        header: Names of the columns.
        rows: The lines after it.
        delimiter: What separates the cells.
        first_line: Number of the line of the first row.
    """

    header: list[str]
    rows: list[list[str]]
    delimiter: str
    first_line: int


def read_table(content: bytes, time_names: Collection[str], names: Collection[str]) -> CsvTable:
    """Take a CSV file apart.

    The header is the first line that names a time column and all others that are asked for; lines before it
    are passed over. Without such a line it is the first one with a time column, or else the first one that is
    neither empty nor a comment.

    Args:
        content: The file.
        time_names: Names that a time column may have.
        names: The other columns.

    Raises:
        InputError: If it is empty or no CSV file.
    """
    try:
        text = _decoded(content)
        first = text.partition("\n")[0]
        if first.startswith("sep="):
            raise InputError(
                f"line 1, {quoted(first.strip())}, is for spreadsheets and no data; remove this line"
            )
        place, start = _header_place(text, set(time_names), set(names))
        line = text[start:].partition("\n")[0]
        delimiter = _delimiter(line)
        lines = csv.reader(io.StringIO(text[start:], newline=""), delimiter=delimiter, strict=True)
        rows = _without_blanks(lines)
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"not a readable CSV file ({error}); give a comma-separated text file") from None
    if not rows or not any(rows[0]):
        raise InputError("the file is empty; the first line names the columns")
    # An umlaut may be one character or two.
    header = [composed(cell) for cell in rows[0]]
    if start or line.startswith(COMMENTS):
        header[0] = _uncommented(header[0])
    return CsvTable(header, rows[1:], delimiter, place + 2)


def further_header(cells: Mapping[str, list[str]], time_name: str) -> tuple[int, dict[str, str]]:
    """Return how many lines after the header are no data, and the units that they say, by column.

    Such a line has no time, no number, and some text: units, descriptions, kinds of samples.

    Args:
        cells: Cells of the columns in use.
        time_name: The column of times.

    Returns:
        Their number, and the units that are known: of the first line that has some.
    """
    units: dict[str, str] = {}
    for n, row in enumerate(islice(zip(*cells.values(), strict=True), _MOST_AFTER + 1)):
        said = {name: _bracketless(cell) for name, cell in zip(cells, row, strict=True)}
        if (
            n == _MOST_AFTER
            or re.search(r"\d", said[time_name])
            or any(map(_is_number, said.values()))
            or not any(said.values())
        ):
            return n, units
        units = units or {name: unit for name, unit in said.items() if unit and in_si(unit) is not None}
    return 0, units


def composed(name: str) -> str:
    """Return a name in which an umlaut is one character."""
    return unicodedata.normalize("NFC", name)


def _without_blanks(lines: Iterable[list[str]]) -> list[list[str]]:
    """Return the cells of all lines up to the last, or up to a blank one between others, which is a fault.

    A blank line at the end is no row; anywhere else its time is missing, so that one line after it is enough.
    A file may hold blank lines by the million.
    """
    rows: list[list[str]] = []
    blank: list[str] | None = None
    for line in lines:
        cells = [cell.strip() for cell in line]
        if not any(cells):
            blank = cells if blank is None else blank
        elif blank is None:
            rows.append(cells)
        else:
            return [*rows, blank, cells]
    return rows


def _header_place(text: str, time_names: set[str], names: set[str]) -> tuple[int, int]:
    """Return how many lines lie before the header, and where in the text it starts."""
    timed = plain = None
    for place, (start, line) in enumerate(islice(_lines(text), _MOST_BEFORE)):
        found = _names(line)
        if time_names & found and names <= found:
            return place, start
        if timed is None and time_names & found:
            timed = place, start
        if plain is None and line.strip() and not line.startswith(COMMENTS):
            plain = place, start
    return timed or plain or (0, 0)


def _names(line: str) -> set[str]:
    """Return what a line names as a header."""
    try:
        (cells,) = csv.reader([line], delimiter=_delimiter(line), strict=True)
    except (csv.Error, ValueError):
        return set()
    return names_of(cells)


def names_of(cells: Iterable[str]) -> set[str]:
    """Return what the cells of a line name, if it is the header."""
    names = [composed(cell.strip()) for cell in cells]
    return {*names, *map(_uncommented, names[:1])}


def _lines(text: str) -> Iterator[tuple[int, str]]:
    start = 0
    while start < len(text):
        end = text.find("\n", start)
        end = len(text) if end < 0 else end
        yield start, text[start:end].rstrip("\r")
        start = end + 1


def _uncommented(name: str) -> str:
    """Return a name without the sign of a comment, which numerical programs write before a header."""
    sign = next((one for one in COMMENTS if name.startswith(one)), "")
    return name.removeprefix(sign).strip()


def _delimiter(line: str) -> str:
    bare = re.sub('"[^"]*"', "", line)
    return next((sign for sign in ";\t" if sign in bare), ",")


def _decoded(content: bytes) -> str:
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return content.decode("utf-16")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # The usual encoding of a spreadsheet's export; its umlauts and degree signs can only be in names.
        return content.decode("cp1252")


def _bracketless(cell: str) -> str:
    return cell[1:-1].strip() if cell[:1] + cell[-1:] in ("[]", "()") else cell


def _is_number(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True
