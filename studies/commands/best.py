"""`studies best`: the best model per training-set size, and the best calibration of each case."""

import argparse

from studies.commands import options
from studies.console import Console

HELP = "show the best model per size and the best calibration of each case"
MORE = """\
what happens: over all labels of a case (profiles, windows, seeds) the completed trial of least
validation error is taken per training-set size. Only models judged on the same validation set stand in
one table. "tuning" is what was gained on the default configuration, which is always trial 0. Below: how
to load the champion in Python, and of each case the parameter values of the best calibration on its
latest window and measurement. Changes nothing.

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
    from simulation.errors import InputError
    from studies.looking.best import best_blocks, best_document
    from studies.looking.names import chosen_labels
    from studies.looking.project import look_at
    from studies.looking.status import FIRST_WORDS
    from studies.paths import find_project

    project = look_at(find_project(chosen.storage))
    labels = chosen_labels(project, chosen.which)
    sizes = sorted({study.n_train for study in project.studies if study.label in labels and study.best})
    for n_train in chosen.n_train or ():
        if n_train not in sizes:
            known = f"there are {', '.join(map(str, sizes))}" if sizes else "there is none yet"
            raise InputError(f"no model of n_train = {n_train}, {known}; studies status shows them")
    blocks = best_blocks(project, labels, chosen.n_train)
    if not blocks:
        console.result(f"No completed trial and no calibration yet; {FIRST_WORDS}")
    console.show(blocks)
    console.document(best_document(project, labels, chosen.n_train))
    return 0
