"""Write tables and figures of all results into one page.

What happens: the command writes the stored results of a label into mlruns/reports/<label>/index.html, with
tables and figures.

Examples:
  studies report
  studies report office-recorded --profile paper
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import document, keywords_of
from studies.words.console import Console

OPTIONS = options.CASE


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.api.judgements import report
    from studies.stages.report_stage import show_report

    result = report(**keywords_of(chosen, console))
    show_report(result.task, result.outcome.result)
    return document(result.task, "report", [result.outcome])
