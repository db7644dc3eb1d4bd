"""`studies reproduce`: make a recorded result again and compare its numbers."""

import argparse

from studies.commands import values
from studies.console import Console

HELP = "make a recorded result again and compare every number"
MORE = """\
RUN is a trial (office-quick/n0064/t003), a study (office-quick/n0064: its best trial), a calibration
(office-quick/calibrate-n0064 or -adaptive), its uncertainty (office-quick/uncertainty-adaptive),
office-quick/sensitivity, or MLflow's id of any of them; its first digits will do.

what happens: case, profile, data sets, seed and settings are rebuilt from what was recorded, not from what
the project holds now; the FMU and the recordings are found by their SHA-256. First it is said what differs:
code, packages, machine, case file, data; a "!" marks what may change a number. Then the result is made again
in a folder of its own, and every number is compared to the last digit. What is stored stays untouched.
Exit code 0 where all numbers are equal, 1 where one differs, 2 where something that is needed is missing.

examples:
  studies reproduce office-quick/n0064            the best trial of a study
  studies reproduce office-quick/calibrate-n0064
  studies reproduce 1f0c9a --json                 a run of MLflow
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument(
        "run", nargs="+", metavar="WORD", help="name of what to make again, in one word or several"
    )
    command.add_argument(
        "--keep", action="store_true", help="keep what was made, in mlruns/reproduced; else it is removed"
    )
    command.add_argument(
        "--jobs", type=values.whole(1), metavar="N", help="processes; default: as many as there are cores"
    )


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from simulation.workers.parallel import available_cores
    from studies.commands.study import FAILED, OK
    from studies.paths import find_project
    from studies.reproduction.reproduce import reproduce, show_reproduction

    done = reproduce(
        find_project(chosen.storage),
        " ".join(chosen.run),
        console,
        n_jobs=chosen.jobs or available_cores(),
        is_kept=chosen.keep,
    )
    show_reproduction(console, done)
    console.document({"command": "reproduce", **done.to_dict()})
    return OK if done.is_equal else FAILED
