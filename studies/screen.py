"""How tables and texts become the lines of a terminal: widths, colours, and a screen that is drawn again."""

import sys
import time
from collections.abc import Callable, Sequence
from typing import Any, Literal

from rich import box
from rich.cells import cell_len
from rich.console import Console as RichConsole
from rich.console import Group, RenderableType
from rich.live import Live
from rich.segment import Segment, Segments
from rich.table import Table as RichTable
from rich.text import Text

from studies.console import Block, Facts, Said, Table
from studies.interrupts import interrupt_heeded

PLAIN_WIDTH = 160
"""Columns of a table that is written to a file or a pipe."""
LEAST_WIDTH = 4
"""Columns of a text that is folded; where there is less room, numbers are folded as well."""
LOOKING = 9.0
"""Pause between two looks, as a multiple of what a look costs: looking takes a tenth of a core at most."""
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


def watch_blocks(look: Callable[[], Sequence[Block]], *, period_s: float) -> None:
    """Draw what is seen again and again until Ctrl-C, then leave the last of it on the terminal.

    Args:
        look: returns what to show.
        period_s: shortest pause between two looks. [s]
    """
    screen = rich_console(sys.stdout)
    blocks: Sequence[Block] = ()
    try:
        with Live(console=screen, screen=True, auto_refresh=False) as live:
            while True:
                started = time.perf_counter()
                blocks = look()
                live.update(_cropped(blocks, screen), refresh=True)
                time.sleep(max(period_s, LOOKING * (time.perf_counter() - started)))
    except KeyboardInterrupt:
        interrupt_heeded()
        print_blocks(blocks)


def _drawn(block: Block, width: int) -> RenderableType:
    """Return what rich prints for a block."""
    if isinstance(block, Said):
        return Text(block.text, style=_STYLES[block.tone])
    if isinstance(block, Facts):
        return _titled(block.title, _facts(block))
    table = RichTable(
        box=box.SIMPLE_HEAD,
        pad_edge=False,
        padding=(0, 1, 0, 0) if block.is_dense else (0, 1),
    )
    kept = _fitting(block, width)
    widths = _folded(block, kept, width)
    for index in kept:
        column = block.columns[index]
        justify: Literal["right", "left"] = "right" if column.is_number else "left"
        # A unit in brackets is no markup.
        table.add_column(Text(column.title), justify=justify, overflow="fold", width=widths.get(index))
    for row in block.rows:
        table.add_row(*(_cell(row[index]) for index in kept))
    return _titled(block.title, table)


def _facts(block: Facts) -> RenderableType:
    grid = RichTable.grid(padding=(0, 2, 0, 0))
    grid.add_column(style=_STYLES["dim"], no_wrap=True)
    grid.add_column(overflow="fold")
    for word, said in block.facts:
        if str(said):
            grid.add_row(f"  {word}", _cell(said))
    return grid


def _titled(title: str, content: RenderableType) -> RenderableType:
    return Group(Text(title, style=_STYLES["strong"]), content) if title else content


def _cell(content: object) -> Text:
    return Text(str(content), style=_STYLES[content.tone] if isinstance(content, Said) else "")


def _fitting(table: Table, width: int) -> list[int]:
    """Return the columns that fit beside each other, the most spare ones left out first."""
    columns, widths = table.columns, _widths(table)
    kept = list(range(len(columns)))
    while sum(widths[i] + _gap(table) for i in kept) > width and any(columns[i].spare for i in kept):
        kept.remove(max(kept, key=lambda i: columns[i].spare))
    return kept


def _folded(table: Table, kept: Sequence[int], width: int) -> dict[int, int]:
    """Return the widths of columns that do not fit unfolded: a number on two lines would be another one."""
    found, gap = dict(zip(range(len(table.columns)), _widths(table), strict=True)), _gap(table)
    if sum(found[i] + gap for i in kept) <= width:
        return {}
    texts = [i for i in kept if not table.columns[i].is_number]
    for i in set(kept).difference(texts):
        words = (*table.columns[i].title.split(), *(str(row[i]) for row in table.rows))
        found[i] = max(cell_len(word) for word in words)
    while sum(found[i] + gap for i in kept) > width:
        widest = max(texts, key=lambda i: found[i], default=-1)
        if widest < 0 or found[widest] <= LEAST_WIDTH:
            return {}
        found[widest] -= 1
    return {i: found[i] for i in kept}


def _widths(table: Table) -> list[int]:
    return [
        max(cell_len(text) for text in (column.title, *(str(row[i]) for row in table.rows)))
        for i, column in enumerate(table.columns)
    ]


def _gap(table: Table) -> int:
    return 2 if table.is_dense else 3


def _cropped(blocks: Sequence[Block], screen: RichConsole) -> RenderableType:
    """Return blocks cut to the height of the terminal, saying so."""
    whole = Group(*(_drawn(block, screen.width) for block in blocks))
    lines = screen.render_lines(whole, pad=False)
    if len(lines) <= screen.height:
        return whole
    fitting = lines[: screen.height - 1]
    segments = [segment for line in fitting for segment in (*line, Segment.line())]
    left = len(lines) - len(fitting)
    return Segments([*segments, Segment(f"... {left} more lines: a taller window shows them")])
