"""Tables and texts that a command shows, before a terminal has drawn them."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """A table's column.

    Args:
        title: heading.
        is_number: align the cells to the right.
        spare: in a narrow terminal, columns with a larger number are left out first; 0 is always shown.
    """

    title: str
    is_number: bool = False
    spare: int = 0


def number(title: str, unit: str = "", spare: int = 0) -> Column:
    """Return a column of numbers, whose unit stands in its heading.

    Args:
        title: heading.
        unit: unit; "" for none.
        spare: as a `Column` has it.
    """
    return Column(f"{title} [{unit}]" if unit else title, True, spare)


@dataclass(frozen=True)
class Table:
    """A table with a title.

    Args:
        title: above it.
        columns: its columns.
        rows: its cells; a cell is anything with a text.
        emphasized: position of the row that the page points out; None for none.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[object]]
    emphasized: int | None = None


Block = Table | str
"""A table, or a text of one or several lines."""
