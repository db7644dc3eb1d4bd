"""Show the best model per size and the best calibration of each case.

What happens: the table shows the best trial of each label (case and profile) and training-set size. Best
means the least validation error among completed trials. Beside its hyperparameters and errors stand the
errors of PCA + GP. The column "gain" is the part of the default configuration's validation error that tuning
took away. Below the table: Python lines that load the study and the model, and the best calibration of
each case on its latest measurement. The command changes nothing.

Examples:
  studies best                             all labels and sizes
  studies best office --n-train 64         one case, one size
  studies best office-quick --json         one label, for programs
"""

import argparse

from simulation.errors import InputError
from studies.commands import options
from studies.console import Console


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "which", nargs="?", metavar="CASE", help="a case, a label, or a pattern of labels; default: all"
    )
    options.add_sizes(command, "training-set sizes; default: all")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.best_models import best_blocks, best_document
    from studies.paths import find_project
    from studies.project import read_project

    paths = find_project(chosen.storage)
    project = read_project(paths, chosen.which)
    known = sorted({one.spec.n_train for one in project.studies})
    for n_train in chosen.n_train or ():
        if n_train not in known:
            there = ", ".join(map(str, known)) or "none"
            raise InputError(
                f"nothing was tuned with n_train = {n_train}, there are {there}; correct --n-train"
            )
    console.show(best_blocks(project, chosen.n_train))
    console.document(best_document(project, chosen.n_train))
    return 0
