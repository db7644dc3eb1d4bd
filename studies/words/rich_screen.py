"""How tables and texts become the lines of a terminal: widths and colours."""

import sys
from collections.abc import Sequence
from typing import Any

from rich import box
from rich.cells import cell_len
from rich.console import Console as RichConsole
from rich.console import Group, JustifyMethod, RenderableType
from rich.table import Table as RichTable
from rich.text import Text

from simulation.foreign_text import escaped
from studies.blocks import Block

PLAIN_WIDTH = 160
"""Columns of a table that is written to a file or a pipe."""


def rich_console(stream: Any) -> RichConsole:
    """Return what draws on a stream; colours and the terminal's own width only where there is one."""
    width = None if stream.isatty() else PLAIN_WIDTH
    return RichConsole(file=stream, width=width, highlight=False)


def print_blocks(blocks: Sequence[Block]) -> None:
    """Write blocks to stdout; a line of text is broken for a terminal and whole for a file or a pipe."""
    screen = rich_console(sys.stdout)
    with screen.capture() as drawn:
        for block in blocks:
            is_whole = isinstance(block, str) and not sys.stdout.isatty()
            screen.print(_drawn(block, screen.width), soft_wrap=is_whole)
    sys.stdout.write("".join(f"{line.rstrip()}\n" for line in drawn.get().splitlines()))
    sys.stdout.flush()


def _drawn(block: Block, width: int) -> RenderableType:
    """Return what rich prints for a block, without signs that a terminal obeys; names may be a stranger's."""
    if isinstance(block, str):
        return Text(escaped(block, keep_lines=True))
    table = RichTable(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    titles = [escaped(column.title) for column in block.columns]
    rows = [[Text(escaped(str(cell))) for cell in row] for row in block.rows]
    widths = [
        2 + max(cell_len(title), *(row[i].cell_len for row in rows), 0) for i, title in enumerate(titles)
    ]
    kept = list(range(len(titles)))
    while sum(widths[i] for i in kept) > width and any(block.columns[i].spare for i in kept):
        kept.remove(max(kept, key=lambda i: block.columns[i].spare))
    fits = sum(widths[i] for i in kept) <= width
    for i in kept:
        is_number = block.columns[i].is_number
        # A number on two lines would be another one: where it is narrow, titles and texts are folded.
        words = [*map(cell_len, titles[i].split()), *(row[i].cell_len for row in rows)]
        whole = max(words, default=0) if is_number and not fits else None
        # A unit in brackets is no markup.
        justify: JustifyMethod = "right" if is_number else "left"
        table.add_column(Text(titles[i]), justify=justify, overflow="fold", width=whole)
    for row in rows:
        table.add_row(*(row[i] for i in kept))
    return Group(Text(escaped(block.title), style="bold"), table) if block.title else table
