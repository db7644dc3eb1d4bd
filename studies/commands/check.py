"""Examine a case and say what is wrong and what to do.

What happens: the command reads the case and compares names, units, bounds and data with the FMU. It
simulates the estimates and the corners of the box, and changes each parameter and each input. It repeats a
simulation in another process and with half the communication step, and measures the time of a simulation.
If nothing fits, it tries columns of one unit in another order and numbers with another sign. Of a case with
experiments, parameters and numbers of values are judged over all of them. The FMU runs in separate
processes: a crash or a hang becomes a line of the table. The first simulation may take as long as the case
allows. After it the check simulates for ten minutes at most, --max-minutes, and names what it skipped for a
slow model; --thorough skips nothing. The study uses the simulations of the check again, and `studies run`
does not repeat a check that passed. The exit code is 1 if anything fails. Each finding says what to do.

Examples:
  studies check                            the office
  studies check fmus/office/case.toml      a case file of your own
  studies check office --window 8-16 --profile paper --json
  studies check slow-model --max-minutes 60
  studies check slow-model --thorough      however long it takes
"""

import argparse

from studies.commands import options
from studies.commands.hand_over import FAILED, OK, keywords_of
from studies.words.console import Console

OPTIONS = (
    *options.CASE,
    options.Option(
        "--thorough", action="store_true", help="skip no check, however long the simulations take"
    ),
    options.Option(
        "--max-minutes", metavar="M", help="simulate for M minutes at most after the first one; default: 10"
    ),
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.api.judgements import check
    from studies.doctor import show_diagnosis
    from studies.results.saved import plain

    result = check(**keywords_of(chosen, console))
    label, diagnosis = result.task.label, result.outcome.result
    show_diagnosis(console, label, diagnosis)
    console.document({"command": "check", "label": label, "sound": result.is_sound} | plain(diagnosis))
    return OK if result.is_sound else FAILED
