"""`studies doctor`: are the stores sound, and what is to be done."""

import argparse

from simulation.errors import InputError
from studies.commands.study import FAILED, OK
from studies.console import Console
from studies.paths import find_project

HELP = "examine the stores: records, Optuna, MLflow, champions, simulations"
MORE = """\
what happens: reads every trial, champion, result and simulation, and compares Optuna's and MLflow's views
with them; looks for trials and runs that nobody works on any more, missing figures and weights, damaged
files, moved folders, leftovers of killed processes, databases of another version, and a full disk. It
changes nothing unless told to; each finding says what to do. (The doctor of a case is `studies check`.)

  --repair    does what is safe: views are written again from the records, ghosts ended, scratch removed,
              damaged files kept aside. A record that can be read is never removed.
  --upgrade   brings MLflow's and Optuna's databases and the descriptions of studies up to date, after a
              copy has been kept in mlruns/copies (PostgreSQL: by pg_dump).

Exit code 0 where all is sound, 1 where there are findings.

examples:
  studies doctor
  studies doctor --repair
  studies doctor --upgrade                 after a new MLflow or Optuna was installed
  STUDIES_STORAGE=postgresql://me@server/studies studies doctor --json
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument("--repair", action="store_true", help="do the repairs that are safe")
    command.add_argument("--upgrade", action="store_true", help="bring stores of earlier versions up to date")
    command.add_argument(
        "--copied", action="store_true", help="with --upgrade: I have kept a copy of the PostgreSQL database"
    )


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.keeping.examination import examine, repair
    from studies.keeping.finding import is_sound, show_findings

    if chosen.copied and not chosen.upgrade:
        raise InputError("--copied belongs to --upgrade; type: studies doctor --upgrade --copied")
    paths = find_project(chosen.storage)
    done: list[str] = []
    if chosen.upgrade:
        from studies.keeping.upgrade import upgrade

        done += upgrade(paths, console, is_copied=chosen.copied)
    findings = examine(paths, console)
    if chosen.repair:
        repaired, findings = repair(paths, console, findings)
        done += repaired
    show_findings(console, f"{paths.root}: the stores", findings)
    console.document(
        {
            "command": "doctor",
            "sound": is_sound(findings),
            "done": done,
            "findings": [finding.to_dict() for finding in findings],
        }
    )
    return OK if is_sound(findings) else FAILED
