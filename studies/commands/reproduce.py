"""Repeat a recorded result and compare every number.

RUN is the id of an MLflow run, of a trial or a calibration. `studies best --json` lists the ids of the best
trials. A calibration may also be given by its name in `studies status`, for example office-quick/adaptive.

What happens: the command takes case, settings and seed from the run. The case file, the FMU and the
recordings must be unchanged (SHA-256); else one line names the changed file. It lists differences of code,
packages and machine. Then it repeats the work and compares every number to the last digit. A calibration
runs all of its simulations again. A trial of a function of yours calls the function again: name it with
--objective, as no record may say what is run. What it measured by a clock differs. Stored results are not
changed. The exit code is 0 if all numbers are equal, 1 if one differs, and 2 if something is missing.

Examples:
  studies reproduce office-quick/adaptive
  studies reproduce office-quick/n0064
  studies reproduce "$RUN_ID" --json       a run of MLflow
  studies reproduce "$RUN_ID" --objective mine:error
"""

import argparse
from dataclasses import asdict

from studies.commands import options
from studies.commands.hand_over import FAILED, OK, keywords_of
from studies.words.console import Console

OPTIONS = (
    options.Option("run", metavar="RUN", help="id of an MLflow run, or the name of a calibration"),
    options.OBJECTIVE,
    options.JOBS,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    options.find_modules(chosen)
    from studies.api.projects import reproduce
    from studies.reproduction import show_reproduction

    result = reproduce(**keywords_of(chosen, console))
    show_reproduction(console, result.run_id, result.rows)
    numbers = [asdict(row) for row in result.rows]
    document = {"command": "reproduce", "run": result.run_id, "equal": result.is_equal, "numbers": numbers}
    console.document(document)
    return OK if result.is_equal else FAILED
