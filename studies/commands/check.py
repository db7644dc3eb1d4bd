"""`studies check`: examine a case and say what is wrong and what to do."""

import argparse

from studies.commands import options
from studies.commands.study import FAILED, OK, open_study
from studies.console import Console

HELP = "examine a case and say what is wrong and what to do"
MORE = """\
what happens: reads the case, checks names, units, bounds and data against the FMU, simulates the
estimates and the corners of the box, moves every parameter and every input, asks again in another process
and at half the communication step, watches the memory, and says what the profile will cost. The FMU runs in
processes of its own: a crash or a hang is a line in the table. It simulates for two minutes at most and says
what a slow model had to go without; --thorough leaves nothing out. What it simulates is kept for the study,
and `studies run` does not examine again what was found sound.
Exit code 1 if anything fails; each finding says what to do.

examples:
  studies check                            the office
  studies check fmus/office/case.toml      a case file of your own
  studies check office --window 8-16 --profile paper --json
  studies check slow-model --thorough      however long it takes
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    options.add_case(command)
    command.add_argument(
        "--thorough", action="store_true", help="do every examination, however long the simulations take"
    )


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.doctor import show_diagnosis
    from studies.stages.check import check_stage

    study = open_study(chosen, console)
    console.say(options.NATIVE_CODE)
    _, diagnosis = check_stage(study, again=True, is_thorough=chosen.thorough)
    show_diagnosis(console, study.label, diagnosis)
    console.document({"command": "check", "label": study.label, **diagnosis.to_dict()})
    return OK if diagnosis.is_sound else FAILED
