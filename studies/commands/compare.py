"""`studies compare`: trials, studies, labels or calibrations side by side."""

import argparse

from studies.console import Console

HELP = "put trials, studies, labels or calibrations side by side"
MORE = """\
what happens: two or more things of one kind, named as `studies show` names them, are put side by side:
first what differs (settings, seed, data, code), then the results with differences and ratios. Studies
and labels are also compared at equal numbers of trials. Errors on other data are shown and flagged as
not comparable. Changes nothing.

examples:
  studies compare office-quick office-paper
  studies compare office-quick/n0064 office-quick-seed1/n0064
  studies compare office-quick/n64/t0 office-quick/n64/t3 --json
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument("first", metavar="A", help="a trial, a study, a label or a calibration")
    command.add_argument("others", nargs="+", metavar="B", help="what it is compared with")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.looking.comparison import compared, comparison_blocks, comparison_document
    from studies.looking.project import look_at
    from studies.paths import find_project

    kind, sides = compared(look_at(find_project(chosen.storage)), [chosen.first, *chosen.others])
    console.show(comparison_blocks(kind, sides))
    console.document(comparison_document(kind, sides))
    return 0
