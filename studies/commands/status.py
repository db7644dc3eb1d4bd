"""Show studies, trials, errors and time to go.

What happens: the command reads Optuna's studies (mlruns/optuna.db, or the database of --storage) and the
finished calibrations. It changes nothing, so you may type it at any moment. Each study has one line: trials
done and planned, pruned, failed and running trials. The line also shows the hyperparameters and errors of
the best trial and the training time that is left. Below are the calibrations.

Examples:
  studies status                           all studies
  watch -n 10 studies status office        studies of one case, again and again
  studies status 'office-quick-seed*'      labels that match a pattern
  studies status --json                    for programs
"""

import argparse

from studies.commands import options
from studies.words.console import Console

OPTIONS = (options.WHICH,)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.api.projects import status
    from studies.project import status_blocks, status_document

    project = status(chosen.which, storage=chosen.storage, tracking=chosen.tracking).project
    console.show(status_blocks(project))
    console.document(status_document(project))
    return 0
