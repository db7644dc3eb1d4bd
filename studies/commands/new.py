"""Write a case file from the description inside an FMU.

What happens: the command writes fmus/<name>/case.toml with the names, units, start values and bounds of the
FMU. It marks each line that you must check with EDIT. It copies the FMU into that folder. It writes a
README and example CSV files with the right columns into data/<name>/. Then save measured.csv there, and
inputs.csv if the FMU has inputs. Check the lines marked EDIT, then type studies check and studies calibrate.

It overwrites nothing. To repeat it, remove the case file; what lies in data/<name>/ is kept. A pattern of
--output that matches no output matches local variables.

Examples:
  studies new Room.fmu
  studies new Room.fmu --list              show its variables and write nothing
  studies new Room.fmu --output TAir --parameter UWin 'wall.*'
  studies new Room.fmu --to ~/office/room  another folder, CSV files beside the case file
"""

import argparse
from pathlib import Path

from studies.commands.options import Option
from studies.paths import find_project
from studies.words.console import Console
from studies.words.wording import NATIVE_CODE

OPTIONS = (
    Option("fmu", type=Path, metavar="FMU", help="an .fmu file, FMI 2.0 or 3.0"),
    Option("--to", type=Path, metavar="FOLDER", help="the case's folder; default: fmus/<name of the FMU>"),
    Option(
        "--output",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        help="measured outputs; default: the first output",
    ),
    Option(
        "--parameter",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME",
        help="parameters to calibrate: names or patterns like 'wall.*', also of inputs that are constant; "
        "default: those of the top level",
    ),
    Option("--list", action="store_true", help="show the variables of the FMU and write nothing"),
)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.new.case_folder import list_variables, new_case

    paths = find_project(chosen.storage, chosen.tracking)
    if chosen.list:
        list_variables(chosen, console)
    else:
        new_case(chosen, paths, console)
        console.say(NATIVE_CODE)
    return 0
