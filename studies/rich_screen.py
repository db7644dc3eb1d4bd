"""How tables and texts become the lines of a terminal: widths and colours."""

import sys
from collections.abc import Sequence
from typing import Any, Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console as RichConsole
from rich.console import Group, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from studies.blocks import Block, Said, Table

PLAIN_WIDTH = 160
"""Columns of a table that is written to a file or a pipe."""
_STYLES = {"": "", "strong": "bold", "dim": "dim", "good": "green", "warn": "yellow", "bad": "red"}


def rich_console(stream: Any) -> RichConsole:
    """Return what draws on a stream; colours and the terminal's own width only where there is one."""
    width = None if stream.isatty() else PLAIN_WIDTH
    return RichConsole(file=stream, width=width, highlight=False)


def print_blocks(blocks: Sequence[Block]) -> None:
    """Write blocks to stdout; a line of text is broken for a terminal and whole for a file or a pipe."""
    screen = rich_console(sys.stdout)
    with screen.capture() as drawn:
        for block in blocks:
            is_whole = isinstance(block, Said) and not sys.stdout.isatty()
            screen.print(_drawn(block, screen.width), soft_wrap=is_whole)
    sys.stdout.write("".join(f"{line.rstrip()}\n" for line in drawn.get().splitlines()))
    sys.stdout.flush()


def _drawn(block: Block, width: int) -> RenderableType:
    """Return what rich prints for a block."""
    if isinstance(block, Said):
        return Text(block.text, style=_STYLES[block.tone])
    table = RichTable(
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0) if block.is_dense else (0, 1),
    )
    kept, fits = _fitting(block, width)
    for index in kept:
        column = block.columns[index]
        justify: Literal["right", "left"] = "right" if column.is_number else "left"
        # A number on two lines would be another one: where it is narrow, titles and texts are folded.
        words = (*column.title.split(), *(str(row[index]) for row in block.rows))
        whole = max(map(cell_len, words)) if column.is_number and not fits else None
        # A unit in brackets is no markup.
        table.add_column(Text(column.title), justify=justify, overflow="fold", width=whole)
    for row in block.rows:
        table.add_row(*(_cell(row[index]) for index in kept))
    return _titled(block.title, table)


def _titled(title: str, content: RenderableType) -> RenderableType:
    return Group(Text(title, style=_STYLES["strong"]), content) if title else content


def _cell(content: object) -> Text:
    return Text(str(content), style=_STYLES[content.tone] if isinstance(content, Said) else "")


def _fitting(table: Table, width: int) -> tuple[list[int], bool]:
    """Return the columns to show, the most spare ones left out first, and whether they fit unfolded."""
    gap, kept = 2 if table.is_dense else 3, list(range(len(table.columns)))
    widths = [
        gap + max(cell_len(text) for text in (column.title, *(str(row[i]) for row in table.rows)))
        for i, column in enumerate(table.columns)
    ]
    while sum(widths[i] for i in kept) > width and any(table.columns[i].spare for i in kept):
        kept.remove(max(kept, key=lambda i: table.columns[i].spare))
    return kept, sum(widths[i] for i in kept) <= width
