"""Simulate the training, validation and test sets.

What happens: the command simulates one training design, a validation set and a test set. The first n rows
of the design are the training set of size n. All studies share these sets. Each simulation is stored in
data/<case>/generated/simulations/, one SQLite file per model. No stored simulation runs again: sampling,
Sobol indices, screening and polishing share them. Failed simulations are stored with their reason, counted,
and left out of training; --retry-failed repeats them. If too many fail, the command stops with exit code 1
(simulation.max_failed_share in the case file).

in pandas: one row per simulation, one column per parameter, one column of bytes per output:
  rows = pandas.read_sql("select * from simulations", sqlite3.connect(FILE))
  y = numpy.stack(rows["TAir"].map(numpy.frombuffer))  # shape (rows, times)

Examples:
  studies simulate --profile paper
  studies simulate my-case/ --jobs 8
  studies simulate my-case/ --dask tcp://scheduler:8786
  studies simulate --retry-failed          for example after a licence server was down
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import document, foretold, keywords_of
from studies.words.console import Console

OPTIONS = (*options.SIMULATED, options.DRY_RUN)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    if chosen.dry_run:
        return foretold(chosen, console)
    from studies.api.chain import simulate
    from studies.stages.simulate_stage import show_sets

    result = simulate(**keywords_of(chosen, console))
    show_sets(result.task, result.outcome.result)
    return document(result.task, "simulate", [result.outcome])
