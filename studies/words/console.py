"""Output on the terminal: stages, progress with time to go, tables.

Progress and stage lines go to stderr. Results go to stdout: tables for people, or one JSON document.
"""

import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from simulation.foreign_text import escaped
from studies.blocks import Block as Block
from studies.blocks import Column as Column
from studies.blocks import Table as Table

# Columns of a progress line for its times, its percentage and a short bar.
_BAR_COLUMNS = 38

OnProgress = Callable[[int, int], None]
"""Called with the steps done and the steps in total."""


class OnBar(Protocol):
    """Receives the progress of tasks that run at the same time."""

    def __call__(self, what: str, done: float, total: float, news: str = "") -> None:
        """Take the name of a task, the steps done, the steps in total, and its latest result."""


@dataclass(frozen=True)
class Console:
    """Writes progress and results for the user.

    Args:
        as_json: the result is one JSON document on stdout and tables are left out.
        quiet: only results and errors.
    """

    as_json: bool = False
    quiet: bool = False

    @property
    def is_live(self) -> bool:
        """Whether progress bars are shown: standard error is a terminal."""
        return not self.quiet and sys.stderr.isatty()

    def say(self, line: str) -> None:
        """Write one line of progress to stderr."""
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
        """Show the progress of a long task and its time to go.

        Yields:
            a function to call with (done, total); a new total replaces the old one.
        """
        with self.bars() as bars:
            bars(what, 0, total)
            yield lambda done, total: bars(what, done, total)

    @contextmanager
    def bars(self) -> Iterator[OnBar]:
        """Show several tasks that run at the same time.

        Yields:
            a function to call with (name of the task, done, total); a new name adds a bar.
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

        from studies.words.rich_screen import rich_console

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
            # In a narrow window, the times matter more than the end of the text.
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
            from studies.words.rich_screen import print_blocks

            print_blocks(blocks)

    def result(self, line: str) -> None:
        """Write one line of the result to stdout, or nothing where the result is a JSON document."""
        if not self.as_json:
            _write(sys.stdout, escaped(line, keep_lines=True))

    def document(self, content: dict[str, Any]) -> None:
        """Write the one JSON document to stdout, or nothing where the result is for people."""
        if self.as_json:
            _write(sys.stdout, json.dumps(content, indent=2, allow_nan=False, default=str))


def format_seconds(seconds: float) -> str:
    """Return a duration with a unit that is easy to read."""
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
