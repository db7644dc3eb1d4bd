"""`studies report`: put tables and figures of all results on one page."""

import argparse

from studies.commands import options
from studies.commands.study import hand_over, open_study
from studies.console import Console

HELP = "put tables and figures of all results on one page"
MORE = """\
what happens: gathers all stored results of the label into mlruns/reports/<label>/index.html with its
figures.

examples:
  studies report
  studies report office-recorded --profile paper
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    options.add_case(command)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.stages.report import report_stage, show_report

    study = open_study(chosen, console)
    outcome = report_stage(study)
    show_report(study, outcome)
    return hand_over(study, "report", [outcome])
