"""Write tables and figures of all results into one page.

What happens: the command writes the stored results of a label into mlruns/reports/<label>/index.html, with
tables and figures.

Examples:
  studies report
  studies report office-recorded --profile paper
"""

import argparse

from studies.commands import options
from studies.commands.task import hand_over, open_task
from studies.words.console import Console

OPTIONS = options.CASE


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.stages.report_stage import report_stage, show_report

    task = open_task(chosen, console)
    outcome = report_stage(task)
    show_report(task, outcome.result)
    return hand_over(task, "report", [outcome])
