"""`studies reproduce`: make a recorded result again and compare its numbers."""

import argparse

from studies.commands import values
from studies.console import Console

HELP = "make a recorded result again and compare every number"
MORE = """\
RUN is the id of an MLflow run, or its first digits: that of a trial (`studies best --json` has those of the
best ones), a calibration, its uncertainty or the sensitivity. Calibrations also go by their names in
`studies status`, such as office-quick/adaptive.

what happens: case, settings and seed are taken from what the run holds. The case file, the FMU and the
recordings must be here as they were (by SHA-256); else one line says which changed. What differs of code,
packages and machine is printed. Then the result is made again and every number is compared to the last digit.
A calibration simulates all of its calls again. Nothing that is stored is changed. Exit code 0 where all
numbers are equal, 1 where one differs, 2 where something that is needed is missing.

examples:
  studies reproduce office-quick/adaptive
  studies reproduce office-quick/n0064
  studies reproduce 1f0c9a52 --json        a run of MLflow
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument("run", metavar="RUN", help="id of an MLflow run, or the name of a calibration")
    command.add_argument(
        "--jobs", type=values.whole(1), metavar="N", help="processes; default: as many as there are cores"
    )


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from simulation.workers.parallel import available_cores
    from studies.commands.study import FAILED, OK
    from studies.paths import find_project
    from studies.reproduction import reproduce, show_reproduction

    jobs = chosen.jobs or available_cores()
    run_id, rows = reproduce(find_project(chosen.storage), chosen.run, console, n_jobs=jobs)
    show_reproduction(console, run_id, rows)
    is_equal = all(row.is_equal for row in rows)
    numbers = [row.to_dict() for row in rows]
    console.document({"command": "reproduce", "run": run_id, "equal": is_equal, "numbers": numbers})
    return OK if is_equal else FAILED
