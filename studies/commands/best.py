"""`studies best`: the best model per training-set size, and the best calibration of each case."""

import argparse

from studies.commands import options
from studies.console import Console

HELP = "show the best model per size and the best calibration of each case"
MORE = """\
what happens: of each label (case and profile) and training-set size, the completed trial of least validation
error is shown with its hyperparameters, and PCA + GP beside it. "tuning" is the part of the default
configuration's validation error that tuning took away. Below: how to read study and model in Python, and each
case's best calibration on its latest measurement. Changes nothing.

examples:
  studies best                             everything there is
  studies best office --n-train 64         one case, one size
  studies best office-quick --json         one label, for programs
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "which", nargs="?", metavar="CASE", help="a case, a label, or a pattern of labels; default: all"
    )
    options.add_sizes(command, "training-set sizes; default: all")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.best import best_blocks, best_document
    from studies.commands.study import refuse_old_project
    from studies.finished import read_project
    from studies.paths import find_project

    paths = find_project(chosen.storage)
    refuse_old_project(paths)
    project = read_project(paths).chosen(chosen.which)
    console.show(best_blocks(project, chosen.n_train))
    console.document(best_document(project, chosen.n_train))
    return 0
