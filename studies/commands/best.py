"""Show the best model per size and the best calibration of each case.

What happens: the table shows the best trial of each label (case and profile) and training-set size. Best
means the least validation error among completed trials. Beside its hyperparameters and errors stand the
errors of PCA + GP. The column "gain" is the part of the default configuration's validation error that tuning
took away. Below the table: Python lines that load the study and the model, and the best calibration of
each case on its latest measurement. The command changes nothing.

Examples:
  studies best                             all labels and sizes
  studies best office                      one case
  studies best office-quick --json         one label, for programs
"""

import argparse

from studies.console import Console
from studies.paths import find_project


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "which", nargs="?", metavar="CASE", help="a case, a label, or a pattern of labels; default: all"
    )


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.best_models import best_blocks, best_document
    from studies.project import read_project

    project = read_project(find_project(chosen.storage), chosen.which)
    console.show(best_blocks(project))
    console.document(best_document(project))
    return 0
