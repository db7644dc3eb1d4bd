"""`studies show`: everything that is known of one thing."""

import argparse

from studies.console import Console

HELP = "show everything known of a trial, study, calibration, ..."
MORE = """\
what happens: RUN is looked for among the names that the other commands print, then among first digits
of digests and of MLflow's run ids. Told are state and reason, settings, errors, the curve, what it was
made with, files, MLflow's page, what it was made from and what was made from it. Changes nothing.

  a label          office-quick                   a calibration    office-quick/calibrate-n0064
  a study          office-quick/n0064             another stage    office-quick/sensitivity
  a trial          office-quick/n0064/t003        a row set        train-n00512-aed94e6056e2
  a digest         3431cf8a                       an MLflow run    3ef99cf6
  a place          mlruns/champions/office-quick/n0064

examples:
  studies show office-quick/n0064/t003     a trial
  studies show n64/t3                      the same where only one label has it
  studies show 3ef99cf6 --json             an MLflow run, for programs
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument("run", metavar="RUN", help="a name, a place, or first digits of a digest or run id")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.looking.names import find_thing, kind_of
    from studies.looking.project import look_at
    from studies.looking.show import lineage_blocks, lineage_values, next_line, thing_blocks, thing_values
    from studies.paths import find_project

    project = look_at(find_project(chosen.storage))
    thing = find_thing(project, chosen.run)
    console.show([*thing_blocks(project, thing), *lineage_blocks(project, thing)])
    console.result(next_line(thing))
    console.document(
        {
            "command": "show",
            "kind": kind_of(thing),
            "name": thing.name,
            **thing_values(project, thing),
            "lineage": lineage_values(project, thing),
        }
    )
    return 0
