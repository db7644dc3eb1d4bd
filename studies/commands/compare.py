"""Compare two profiles or labels, size by size.

A and B are labels (office-quick), patterns of one label, or names or files of profiles.

What happens: the command reads Optuna's studies and changes nothing. For each training-set size it shows the
validation MAE and P90 of the best trial of both, their trials, and their simulations. Where a profile
confirms its best configurations with further seeds, an error is mean ± standard deviation over these;
else it is one training. One label is called better if noise alone would make such a difference with a
probability below 5 % (Welch's t-test over the seeds). With one seed each that is not known, nor where
different validation rows judge.

Examples:
  studies compare quick thorough
  studies compare office-quick office-quick-seed3
  studies compare quick my.toml --json     for programs
"""

import argparse

from studies.commands import options
from studies.words.console import Console

OPTIONS = (
    options.Option("first", metavar="A", help="a label or a profile"),
    options.Option("second", metavar="B", help="the label or profile to compare it with"),
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.api.projects import compare
    from studies.comparison import compare_blocks, compare_document

    found = compare(chosen.first, chosen.second, storage=chosen.storage, tracking=chosen.tracking)
    console.show(compare_blocks(found.labels, found.sizes))
    console.document(compare_document(found.labels, found.sizes))
    return 0
