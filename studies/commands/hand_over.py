"""What commands share: keywords for the function of their name, and one JSON document of its result."""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from studies.words.console import Console

if TYPE_CHECKING:
    from studies.results.outcome import Outcome
    from studies.task import Task

OK, FAILED = 0, 1
_OF_THE_TERMINAL = ("command", "json", "quiet", "dry_run")


def keywords_of(chosen: argparse.Namespace, console: Console) -> dict[str, Any]:
    """Return what a function is called with that does what a command line says.

    Args:
        chosen: The options of the command line.
        console: Shows progress and results.
    """
    words = {name: value for name, value in vars(chosen).items() if name not in _OF_THE_TERMINAL}
    return words | {"console": console}


def foretold(chosen: argparse.Namespace, console: Console) -> int:
    """Show what a command would do, for --dry-run, and return the exit code."""
    from studies.forecast import foretell
    from studies.opening import open_task

    given = vars(chosen)
    foretell(open_task(chosen.command, given, console, ""), chosen.command, given)
    return OK


def document(task: "Task", command: str, outcomes: "Sequence[Outcome[Any]]", **extra: Any) -> int:
    """Write the results of stages as one JSON document, where one is wanted, and return the exit code."""
    task.console.document(
        {
            "command": command,
            "case": task.case.name,
            "profile": task.profile.name,
            "label": task.label,
            "note": task.case.note,
            "stages": [outcome.to_dict(task.paths) for outcome in outcomes],
            **extra,
        }
    )
    return OK
