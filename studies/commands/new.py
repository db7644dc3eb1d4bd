"""`studies new`: write a case file from what an FMU says about itself."""

import argparse

from studies.commands import options
from studies.console import Console
from studies.paths import find_project

HELP = "write a case file from what an FMU says about itself"
MORE = """\
what happens: writes fmus/<name>/case.toml in the project's folder with the FMU's own names, units, start
values and bounds. Every line that needs you is marked EDIT. Copies the FMU beside it; writes README and
example CSV files with the right columns into data/<name>/. Nothing is overwritten. Save two CSV files there
(measured.csv, and inputs.csv where the FMU has inputs), go through the lines marked EDIT, then check, then
calibrate.

examples:
  studies new Room.fmu
  studies new Room.fmu --list              its variables; nothing is written
  studies new Room.fmu --output TAir --parameter UWin 'wall.*'
  studies new Room.fmu --to ~/office/room  a folder of its own, CSV files beside the case file
"""


def add_options(command: argparse.ArgumentParser) -> None:
    """Say what may be typed after the command."""
    command.add_argument("fmu", metavar="FMU", help="an .fmu file, FMI 2.0 or 3.0")
    command.add_argument("--to", metavar="FOLDER", help="the case's folder; default: fmus/<name of the FMU>")
    command.add_argument(
        "--output", nargs="+", action="extend", metavar="NAME", help="measured outputs; default: the first"
    )
    command.add_argument(
        "--parameter",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="parameters to calibrate, names or patterns like 'wall.*'; default: those at the top level",
    )
    command.add_argument(
        "--interface",
        choices=("co-simulation", "model-exchange"),
        help="how the FMU is run; default: co-simulation where the FMU offers it",
    )
    command.add_argument("--all", action="store_true", help="write every variable, however many there are")
    command.add_argument("--list", action="store_true", help="show the FMU's variables and write nothing")


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.new.terminal import list_variables, new_case

    paths = find_project(chosen.storage)
    if chosen.list:
        return list_variables(chosen, paths, console)
    code = new_case(chosen, paths, console)
    console.say(options.NATIVE_CODE)
    return code
