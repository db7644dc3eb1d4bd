"""`studies simulate`: simulate the training, validation and test sets."""

import argparse

from studies.commands import options
from studies.commands.study import hand_over, open_study
from studies.console import Console

HELP = "simulate the training, validation and test sets"
MORE = """\
what happens: one training design (its first n rows are the training set of size n), a validation and a
test set that every study shares. Every simulated row is stored in data/<case>/generated/simulations/, a
folder of Parquet files whose _README.txt says how to read them, and is never simulated again, whatever asks
for it: sampling, Sobol indices, screening checks or polishing. Failed simulations are kept as such, counted,
and left out of training; --retry-failed asks them again. When too many fail, the campaign stops with exit
code 1 (simulation.max_failed_share in the case file).

examples:
  studies simulate --profile paper
  studies simulate my-case/ --jobs 8
  studies simulate my-case/ --dask tcp://scheduler:8786
  studies simulate --retry-failed          after the licence server is back
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    options.add_case(command)
    options.add_simulation(command)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.stages.simulate import show_sets, simulate_stage

    study = open_study(chosen, console)
    outcome = simulate_stage(study)
    show_sets(study, outcome)
    return hand_over(study, "simulate", [outcome])
