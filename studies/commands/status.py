"""`studies status`: what every study has come to, and what runs at this moment."""

import argparse

from studies.console import Console

HELP = "show studies, trials, errors and time to go"
MORE = """\
what happens: reads the records of this project (mlruns/, or the PostgreSQL of --storage) and changes
nothing, so it can be typed at any moment, also from another machine. One line per study: trials done of
those planned, those pruned, failed and running, the errors of the best trial, its pace and the time to
go; below it the running trials and the calibrations. --live draws it again and again until Ctrl-C.

examples:
  studies status                           everything
  studies status office --live             studies of one case, as they go
  studies status 'office-quick-seed*'      labels of a pattern
  studies status --json                    for programs
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "which", nargs="?", metavar="CASE", help="a case, a label, or a pattern of labels; default: all"
    )
    command.add_argument(
        "--live", "--watch", action="store_true", help="draw it again and again until Ctrl-C"
    )


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.looking.names import chosen_labels
    from studies.looking.project import look_at
    from studies.looking.status import status_blocks, status_document
    from studies.paths import find_project

    paths = find_project(chosen.storage)
    if chosen.which is not None:
        chosen_labels(look_at(paths), chosen.which)
    if chosen.live and not console.as_json:
        console.watch(lambda: status_blocks(look_at(paths), chosen.which))
        return 0
    project = look_at(paths)
    console.show(status_blocks(project, chosen.which))
    console.document(status_document(project, chosen.which))
    return 0
