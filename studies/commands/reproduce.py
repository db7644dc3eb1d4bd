"""Repeat a recorded result and compare every number.

RUN is the id of an MLflow run, of a trial or a calibration. `studies best --json` lists the ids of the best
trials. A calibration may also be given by its name in `studies status`, for example office-quick/adaptive.

What happens: the command takes case, settings and seed from the run. The case file, the FMU and the
recordings must be unchanged (SHA-256); else one line names the changed file. It lists differences of code,
packages and machine. Then it repeats the work and compares every number to the last digit. A calibration
runs all of its simulations again. Stored results are not changed. The exit code is 0 if all numbers are
equal, 1 if one differs, and 2 if something is missing.

Examples:
  studies reproduce office-quick/adaptive
  studies reproduce office-quick/n0064
  studies reproduce "$RUN_ID" --json       a run of MLflow
"""

import argparse
from dataclasses import asdict

from studies.commands import options
from studies.commands.task import FAILED, OK
from studies.paths import find_project
from studies.words.console import Console

OPTIONS = (
    options.Option("run", metavar="RUN", help="id of an MLflow run, or the name of a calibration"),
    options.JOBS,
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from simulation.pool.pool_model import available_cores
    from studies.reproduction import reproduce, show_reproduction

    jobs = chosen.jobs or available_cores()
    run_id, rows = reproduce(find_project(chosen.storage), chosen.run, console, n_jobs=jobs)
    show_reproduction(console, run_id, rows)
    is_equal = all(row.is_equal for row in rows)
    numbers = [asdict(row) for row in rows]
    console.document({"command": "reproduce", "run": run_id, "equal": is_equal, "numbers": numbers})
    return OK if is_equal else FAILED
