"""What a user sees on the terminal: stages, progress with time to go, tables. Only this module knows rich.

Progress and stage lines go to stderr. Results go to stdout: tables for people, or one JSON document.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from rich.console import Console as RichConsole

PLAIN_WIDTH = 160
"""Columns of a table that is written to a file or a pipe."""

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
    """

    title: str
    is_number: bool = False


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
            _write(sys.stderr, line)

    def warn(self, line: str) -> None:
        """Write one line to stderr, also when quiet."""
        _write(sys.stderr, f"studies: {line}")

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

        progress = Progress(
            TextColumn("  {task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TextColumn("to go"),
            TimeRemainingColumn(elapsed_when_finished=False),
            console=_rich(sys.stderr),
            transient=True,
        )
        tasks: dict[str, TaskID] = {}

        def show(what: str, done: float, total: float, news: str = "") -> None:
            if what not in tasks:
                tasks[what] = progress.add_task(what, total=total)
            progress.update(tasks[what], completed=done, total=total, description=f"{what}{news}")

        with progress:
            yield show

    def table(self, title: str, columns: Sequence[Column], rows: Sequence[Sequence[object]]) -> None:
        """Write a table to stdout, or nothing where the result is a JSON document."""
        if self.as_json:
            return
        from rich import box
        from rich.table import Table
        from rich.text import Text

        table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
        for column in columns:
            table.add_column(column.title, justify="right" if column.is_number else "left", overflow="fold")
        for row in rows:
            table.add_row(*(Text(str(cell)) for cell in row))
        _rich(sys.stdout).print(table)

    def result(self, line: str) -> None:
        """Write one line of the result to stdout, or nothing where the result is a JSON document."""
        if not self.as_json:
            _write(sys.stdout, line)

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


def _write(stream: Any, line: str) -> None:
    stream.write(line + "\n")
    stream.flush()


def _rich(stream: Any) -> "RichConsole":
    from rich.console import Console as RichConsole

    width = None if stream.isatty() else PLAIN_WIDTH
    return RichConsole(file=stream, width=width, highlight=False)
