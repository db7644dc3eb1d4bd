"""Tables and texts that a command shows, before a terminal has drawn them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Tone = Literal["", "strong", "dim", "good", "warn", "bad"]
"""Tone of a text: good, bad, a warning, strong, or of less weight."""


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


@dataclass(frozen=True)
class Said:
    """A text with a tone, which a terminal shows as a colour and a file does not show at all.

    Args:
        text: the text.
        tone: how it is said.
    """

    text: str
    tone: Tone = ""

    def __str__(self) -> str:
        """Return the text."""
        return self.text


@dataclass(frozen=True)
class Table:
    """A table with a title.

    Args:
        title: above it.
        columns: its columns.
        rows: its cells; a cell is anything with a text, or a `Said`.
        is_dense: two blanks between columns, not three.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[object]]
    is_dense: bool = False


Block = Table | Said
"""A table, or a text of one or several lines."""
