"""`studies new` on the terminal: what was written, which lines need the user, what to type next."""

import argparse
from pathlib import Path
from typing import Any

from simulation.fmi.variable import REAL_KINDS, FmuVariable
from studies.console import Column, Console
from studies.new.case_folder import MadeCase, describe, make_case
from studies.new.choice import bounds_for, choose_parameters, parameter_candidates
from studies.paths import ProjectPaths, mark_project
from studies.report.wording import count

OK = 0
_NUMBERS = [Column(word, True) for word in ("start", "min", "max")]


def new_case(options: argparse.Namespace, paths: ProjectPaths, console: Console) -> int:
    """Write a case and say what comes next."""
    made = make_case(
        Path(options.fmu).expanduser(),
        paths,
        folder=None if options.to is None else Path(options.to).expanduser(),
        outputs=options.output or (),
        parameters=options.parameter or (),
    )
    mark_project(paths.root, console)
    case, name = made.case, paths.show(made.file)
    for file in made.files:
        console.result(f"wrote {paths.show(file)}")
    for file in made.kept:
        console.result(f"kept {paths.show(file)}, which was there")
    console.result(
        f"{case.name}: {case.interface}, {count(len(case.parameters.used), 'parameter')} to calibrate"
        f"{_of(case.parameters.used, case.parameters.others)}, {count(len(case.inputs), 'input')}, "
        f"{count(len(case.outputs.used), 'output')}{_of(case.outputs.used, case.outputs.others)}"
    )
    console.result("\n".join(_next_steps(made, paths)))
    console.document(
        {
            "command": "new",
            "case": case.name,
            "interface": case.interface,
            "files": [paths.show(file) for file in made.files],
            "parameters": [v.name for v in case.parameters.used],
            "inputs": [v.name for v in case.inputs],
            "outputs": [v.name for v in case.outputs.used],
            "edit": [{"file": name, "line": number, "text": text} for number, text in made.to_edit],
            "next": [f"studies check {case.place}", f"studies calibrate {case.place}"],
        }
    )
    return OK


def list_variables(options: argparse.Namespace, paths: ProjectPaths, console: Console) -> int:
    """Show what an FMU can be given and asked."""
    fmu = describe(Path(options.fmu).expanduser())
    named = options.parameter or ()
    is_any = named or parameter_candidates(fmu)
    active = {v.name for v in choose_parameters(fmu, named).used} if is_any else set()
    document: dict[str, Any] = {"command": "new"}

    for what in (*["output"] * bool(fmu.names("output")), "input", "parameter", "local"):
        found = [fmu.variables[name] for name in fmu.names(what)]
        document[f"{what}s"] = [_as_json(v, active) for v in found]
        console.table(
            f"{fmu.path.name}: {count(len(found), what)}",
            [Column(what), Column("type"), *_NUMBERS, Column("unit"), Column("meaning")],
            [
                [v.name + " *" * (v.name in active), v.kind, *_numbers(v), v.unit, v.description]
                for v in found
            ],
        )
    if active:
        console.result("* calibrated" + ("" if named else " unless you name others with --parameter"))
    console.document(document)
    return OK


def _next_steps(made: MadeCase, paths: ProjectPaths) -> list[str]:
    case, data = made.case, paths.show((made.file.parent / made.case.data).resolve())
    lines = ", ".join(str(number) for number, _ in made.to_edit)
    steps = [f"save {data}/{file}: {_columns(variables)}" for file, variables, _ in case.tables]
    steps.append(f"look at the lines marked EDIT of {paths.show(made.file)}: {lines}")
    steps += [f"studies {word} {case.place}" for word in ("check", "calibrate")]
    return ["next:", *(f"  {number}. {step}" for number, step in enumerate(steps, start=1))]


def _columns(variables: tuple[FmuVariable, ...], most: int = 8) -> str:
    names = ["time_s", *(v.name + (f" [{v.unit}]" if v.unit else "") for v in variables[:most])]
    return "columns " + ", ".join(names) + (", ..." if len(variables) > most else "")


def _of(used: tuple[FmuVariable, ...], others: tuple[FmuVariable, ...]) -> str:
    return f" of {len(used) + len(others)}" if others else ""


def _as_json(variable: FmuVariable, active: set[str]) -> dict[str, Any]:
    found: dict[str, Any] = {
        "name": variable.name,
        "type": variable.kind,
        "start": variable.start,
        "min": variable.minimum,
        "max": variable.maximum,
        "unit": variable.unit,
        "description": variable.description,
    }
    if variable.causality == "parameter" and variable.kind in REAL_KINDS:
        box = bounds_for(variable)
        found |= {"lower": box.lower, "upper": box.upper, "scale": box.scale}
        found["calibrated"] = variable.name in active
    return found


def _numbers(variable: FmuVariable) -> list[str]:
    values = (variable.start, variable.minimum, variable.maximum)
    start, *ends = ("" if value is None else f"{value:g}" for value in values)
    return [start or variable.start_text, *ends]
