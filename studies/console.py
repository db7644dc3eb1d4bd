"""What a user sees on the terminal: stages, progress with time to go, tables.

Progress and stage lines go to stderr. Results go to stdout: tables for people, or one JSON document.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol

from simulation.foreign_text import escaped

Tone = Literal["", "strong", "dim", "good", "warn", "bad"]
"""How something is said: what is good, to be looked at, or of less weight."""

# Of a progress bar's line, what its times, its percentage and a short bar take.
_BAR_COLUMNS = 38

OnProgress = Callable[[int, int], None]
"""Called with what is done and what there is to do."""


class OnBar(Protocol):
    """Is told how far the works are that go on side by side."""

    def __call__(self, what: str, done: float, total: float, news: str = "") -> None:
        """Hear the name of a work, what is done, what there is to do, and what was found so far."""


@dataclass(frozen=True)
class Column:
    """A table's column.

    Args:
        title: heading.
        is_number: numbers stand right.
        spare: columns with a larger number are left out first where the terminal is too narrow; 0 never is.
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


@dataclass(frozen=True)
class Facts:
    """What is known of one thing, a line each; facts without a text are left out.

    Args:
        title: above them.
        facts: pairs of a word and what it says.
    """

    title: str
    facts: Sequence[tuple[str, object]]


Block = Table | Facts | Said
"""What stands on its own: a table, facts, or a text of one or several lines."""


@dataclass(frozen=True)
class Console:
    """Tells the user what happens.

    Args:
        as_json: the result is one JSON document on stdout and tables are left out.
        quiet: nothing but results and errors.
    """

    as_json: bool = False
    quiet: bool = False

    @property
    def is_live(self) -> bool:
        """Whether there are progress bars: somebody watches stderr."""
        return not self.quiet and sys.stderr.isatty()

    def say(self, line: str) -> None:
        """Write one line of news to stderr."""
        if not self.quiet:
            _write(sys.stderr, escaped(line))

    def warn(self, line: str) -> None:
        """Write one line to stderr, also when quiet."""
        _write(sys.stderr, escaped(f"studies: {line}"))

    @contextmanager
    def stage(self, name: str, what: str) -> Iterator[None]:
        """Say when a stage starts and when it is finished."""
        self.say(f"{name}: {what}")
        started = time.perf_counter()
        yield
        self.say(f"{name}: finished in {format_seconds(time.perf_counter() - started)}")

    @contextmanager
    def progress(self, what: str, total: int) -> Iterator[OnProgress]:
        """Show how far a long work is and how long it will go on.

        Yields:
            a function to call with (done, total); a new total replaces the first.
        """
        with self.bars() as bars:
            bars(what, 0, total)
            yield lambda done, total: bars(what, done, total)

    @contextmanager
    def bars(self) -> Iterator[OnBar]:
        """Show several works that go on side by side.

        Yields:
            a function to call with (name of the work, done, total); a new name is a new bar.
        """
        if not self.is_live:
            yield lambda what, done, total, news="": None
            return
        from rich.progress import (
            BarColumn,
            Progress,
            TaskID,
            TaskProgressColumn,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        from studies.screen import rich_console

        progress = Progress(
            TextColumn("  {task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("to go"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=rich_console(sys.stderr),
            transient=True,
        )
        tasks: dict[str, TaskID] = {}

        def show(what: str, done: float, total: float, news: str = "") -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=total)
            said = escaped(f"{what}{news}")
            # In a narrow window the times are worth more than the end of the words.
            room = max(progress.console.width - _BAR_COLUMNS, 12)
            said = said if len(said) <= room else said[: room - 1] + "…"
            progress.update(tasks[what], completed=done, total=total, description=said)

        with progress:
            yield show

    def table(self, title: str, columns: Sequence[Column], rows: Sequence[Sequence[object]]) -> None:
        """Write a table to stdout, or nothing where the result is a JSON document."""
        self.show([Table(title, columns, rows)])

    def show(self, blocks: Sequence[Block]) -> None:
        """Write tables and texts to stdout, or nothing where the result is a JSON document."""
        if not self.as_json:
            from studies.screen import print_blocks

            print_blocks([_without_control(block) for block in blocks])

    def watch(self, look: Callable[[], Sequence[Block]], *, period_s: float = 1.0) -> None:
        """Show tables and texts over and over until Ctrl-C; once where nobody watches.

        Args:
            look: returns what to show; may take its time.
            period_s: shortest pause between two looks. [s]
        """
        if self.as_json or self.quiet or not sys.stdout.isatty():
            self.show(look())
            return
        from studies.screen import watch_blocks

        watch_blocks(lambda: [_without_control(block) for block in look()], period_s=period_s)

    def result(self, line: str) -> None:
        """Write one line of the result to stdout, or nothing where the result is a JSON document."""
        if not self.as_json:
            _write(sys.stdout, escaped(line, keep_lines=True))

    def document(self, content: dict[str, Any]) -> None:
        """Write the one JSON document to stdout, or nothing where the result is for people."""
        if self.as_json:
            _write(sys.stdout, json.dumps(content, indent=2, allow_nan=False, default=str))


def format_seconds(seconds: float) -> str:
    """Return a duration as people say it."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.1f} min"
    return f"{seconds / 3600:.1f} h"


def _without_control(block: Block) -> Block:
    """Return a block without signs that a terminal obeys; names in it may be a stranger's."""
    if isinstance(block, Said):
        return replace(block, text=escaped(block.text, keep_lines=True))
    if isinstance(block, Facts):
        facts = [(escaped(word), _safe_cell(said, keep_lines=True)) for word, said in block.facts]
        return Facts(escaped(block.title), facts)
    columns = [replace(column, title=escaped(column.title)) for column in block.columns]
    rows = [[_safe_cell(cell) for cell in row] for row in block.rows]
    return replace(block, title=escaped(block.title), columns=columns, rows=rows)


def _safe_cell(cell: object, *, keep_lines: bool = False) -> object:
    text = escaped(str(cell), keep_lines=keep_lines)
    return replace(cell, text=text) if isinstance(cell, Said) else text


def _write(stream: Any, line: str) -> None:
    stream.write(line + "\n")
    stream.flush()
