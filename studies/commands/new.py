"""Write a case file from the description inside an FMU.

What happens: the command writes fmus/<name>/case.toml with the names, units, start values and bounds of the
FMU. It marks each line that you must check with EDIT. It copies the FMU into that folder. It writes a
README and example CSV files with the right columns into data/<name>/. Then save measured.csv there, and
inputs.csv if the FMU has inputs. Check the lines marked EDIT, then type studies check and studies calibrate.

A PEtab problem (version 1 or 2) with an FMU as its model becomes a case as well: bounds, scales, nominal
values, priors, noise, conditions and measurements are taken over. Its note says what PEtab's chi² is. The FMU
has the names of the parameters, and outputs with the names or formulas of the observables. What a case cannot
say is named in one line: estimated scales, logarithms of observables, steady states.

Values of an SSV file are the estimates of parameters that are calibrated; others are held under [fixed]. An
SSP file with one FMU is read with the values that it gives to it.

It overwrites nothing. To repeat it, remove the case file; what lies in data/<name>/ is kept. A pattern of
--output that matches no output matches local variables.

Examples:
  studies new Room.fmu
  studies new Room.fmu --list              show its variables and write nothing
  studies new Room.fmu --output TAir --parameter UWin 'wall.*'
  studies new Room.fmu --to ~/office/room  another folder, CSV files beside the case file
  studies new Room.fmu --values room.ssv   start from values of another program
  studies new cells.yaml --fmu Cells.fmu   a PEtab problem; needs the extra petab
"""

import argparse
import shlex
from pathlib import Path

from simulation.errors import InputError
from studies.commands.options import Option
from studies.paths import ProjectPaths, find_project
from studies.words.console import Console
from studies.words.wording import NATIVE_CODE

OPTIONS = (
    Option(
        "fmu",
        type=Path,
        metavar="FMU",
        help="an .fmu file, FMI 2.0 or 3.0; an .ssp with one; or a PEtab problem's .yaml",
    ),
    Option("--fmu", dest="model", type=Path, metavar="FMU", help="the model of a PEtab problem"),
    Option("--values", type=Path, metavar="SSV", help="an SSV file: estimates, and values under [fixed]"),
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


def _new_petab(chosen: argparse.Namespace, paths: ProjectPaths, console: Console) -> None:
    from studies.api.petab_case import petab_case
    from studies.paths import mark_project

    if chosen.model is None or chosen.list or chosen.output or chosen.parameter or chosen.values:
        raise InputError(
            f"{chosen.fmu} is a PEtab problem, which names outputs and parameters: studies new "
            f"{shlex.quote(str(chosen.fmu))} --fmu Model.fmu"
        )
    file, note = petab_case(chosen.fmu.expanduser(), chosen.model.expanduser(), paths, chosen.to)
    mark_project(paths, console)
    place = shlex.quote(file.parent.name if file.parent.parent == paths.fmus else paths.show(file))
    console.result(f"wrote {paths.show(file)}")
    console.result(note)
    following = [f"studies {word} {place}" for word in ("check", "calibrate")]
    console.result("\n".join(["next:", *(f"  {n}. {one}" for n, one in enumerate(following, start=1))]))
    console.document({"command": "new", "files": [paths.show(file)], "note": note, "next": following})
    console.say(NATIVE_CODE)


def run(chosen: argparse.Namespace, console: Console) -> int:
    """Do it and return the exit code."""
    from studies.new.case_folder import list_variables, new_case

    paths = find_project(chosen.storage, chosen.tracking)
    if chosen.fmu.suffix in (".yaml", ".yml"):
        _new_petab(chosen, paths, console)
    elif chosen.model is not None:
        raise InputError(f"--fmu is the model of a PEtab problem, and {chosen.fmu} is no .yaml file")
    elif chosen.list:
        list_variables(chosen, console)
    else:
        new_case(chosen, paths, console)
        console.say(NATIVE_CODE)
    return 0
