"""`studies new`: from an FMU's own description to a case file, a data folder and example CSV files."""

import argparse
import re
import shlex
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.fmi.description import FmuDescription, read_description
from simulation.fmi.variable import REAL_KINDS, FmuVariable, Value
from simulation.scratch import ScratchFolder
from simulation.whole_file import whole_file
from simulation.write_gate import check_written
from studies.new.choice import (
    bounds_for,
    choose_outputs,
    choose_parameters,
    choose_times,
    inputs_of,
    parameter_candidates,
)
from studies.new.column_kinds import noise_of, switches_of
from studies.new.system import Said, read_values, unpack_system, with_values
from studies.new.text import NewCase, case_text, data_readme, example_files, lines_to_edit
from studies.paths import ProjectPaths, mark_project
from studies.words.console import Column, Console
from studies.words.wording import axis_label, count


@dataclass(frozen=True)
class MadeCase:
    """What was written.

    Attributes:
        case: Its content.
        files: All files, the case file first.
        kept: Files that were there already, which are left as they are.
        to_edit: Lines of the case file that are marked EDIT, with their numbers.
    """

    case: NewCase
    files: tuple[Path, ...]
    kept: tuple[Path, ...]
    to_edit: tuple[tuple[int, str], ...]


def make_case(options: argparse.Namespace, paths: ProjectPaths) -> MadeCase:
    """Write a case file for an FMU, copy the FMU beside it and lay out the folder of its recordings.

    Args:
        options: The words of `studies new`.
        paths: The project.

    Raises:
        InputError: The FMU cannot be used, a name is not in it or twice, there is a case file or another FMU
            of that name, or the folder cannot be written.
    """
    with _model(options) as (fmu_file, fmu, values):
        return _made(options, paths, fmu_file, fmu, values)


@contextmanager
def _model(options: argparse.Namespace) -> Iterator[tuple[Path, FmuDescription, dict[str, Value]]]:
    """Yield the FMU that is named, or that of an SSP file, with the values of parameters that are given."""
    file: Path = options.fmu.expanduser()
    with ExitStack() as stack:
        said: Said = {}
        if file.suffix.lower() == ".ssp" and file.exists():
            scratch = ScratchFolder("studies-system-")
            stack.callback(scratch.remove)
            file, said = unpack_system(file, scratch.folder)
        if options.values is not None:
            said = {**said, **read_values(options.values.expanduser())}
        fmu, values = with_values(describe(file), said, str(options.values or options.fmu))
        yield file, fmu, values


def _made(
    options: argparse.Namespace,
    paths: ProjectPaths,
    fmu_file: Path,
    fmu: FmuDescription,
    values: Mapping[str, Value],
) -> MadeCase:
    folder = _folder(fmu_file, paths, options.to)
    name = case_name(folder.name)
    chosen = choose_parameters(fmu, options.parameter)
    is_named = folder.parent.resolve() == paths.fmus.resolve() and folder.name == name
    data = paths.data / name if is_named else folder
    fixed = {one: value for one, value in values.items() if one not in {v.name for v in chosen.used}}
    case = NewCase(
        name=name,
        place=name if is_named else shlex.quote(paths.show(folder)),
        fmu=fmu,
        fmu_file=fmu_file.name,
        data=f"../../data/{name}" if is_named else ".",
        interface=fmu.usual_interface,
        inputs=tuple(one for one in inputs_of(fmu) if one not in chosen.used and one.name not in fixed),
        fixed=fixed,
        outputs=choose_outputs(fmu, options.output),
        parameters=chosen,
        times=choose_times(fmu),
    )
    case = replace(case, switches=switches_of(case, data), noise=noise_of(case, data))
    for one in (*case.inputs, *case.outputs.used, *case.parameters.used):
        one.require_once(str(fmu_file))
    case_file, copied = folder / "case.toml", folder / fmu_file.name
    texts = {data / file: content for file, content in example_files(case).items()}
    texts |= {data / "README.md": data_readme(case), case_file: case_text(case)}
    # One's own data and what was written beside them stay as they are.
    kept = [file for file, text in texts.items() if file != case_file and _holds_other(file, text.encode())]
    texts = {file: text for file, text in texts.items() if file not in kept}
    is_copied = write_case({file: text.encode() for file, text in texts.items()}, fmu_file, copied, paths)
    files = (*reversed(texts), *[copied] * is_copied)
    return MadeCase(case, files, tuple(kept), tuple(lines_to_edit(texts[case_file])))


def write_case(files: Mapping[Path, bytes], fmu_file: Path, copied: Path, paths: ProjectPaths) -> bool:
    """Write the files of a case and copy the FMU, or nothing where one of them would be overwritten.

    The case file is the last one, so that a command that was killed can be typed again: what it had written
    is there already.

    Args:
        files: Their contents.
        fmu_file: The FMU.
        copied: Where it is copied.
        paths: The project.

    Returns:
        Whether the FMU was copied.

    Raises:
        InputError: The case file or another file of a name is there, or the folder cannot be written.
    """
    case_file, every = list(files)[-1], {copied: fmu_file.read_bytes(), **files}
    others = (file for file, content in every.items() if _holds_other(file, content))
    for file in [case_file] if case_file.exists() else others:
        raise InputError(
            f"{paths.show(file)} exists and is never overwritten; choose another folder: --to FOLDER"
        )
    is_copied = not copied.exists()
    try:
        for file in [copied] * is_copied + list(files):
            with whole_file(file) as stream:
                stream.write(every[file])
    except OSError as error:
        place = paths.show(Path(error.filename or case_file.parent))
        raise InputError(
            f"{place}: the case cannot be written there ({error.strerror}); choose another folder: "
            "--to FOLDER"
        ) from None
    return is_copied


def _holds_other(file: Path, content: bytes) -> bool:
    return file.exists() and not (file.is_file() and file.read_bytes() == content)


def describe(fmu_file: Path) -> FmuDescription:
    """Read an FMU's description.

    Raises:
        InputError: There is no such file, or it is no FMU that can run here.
    """
    if not fmu_file.exists():
        raise InputError(f"{fmu_file}: no such file; give the path of an .fmu file")
    return read_description(fmu_file)


def case_name(text: str) -> str:
    """Return the name of a case: what a label, a folder and a database may hold."""
    name = re.sub(r"[^a-z0-9_]+", "-", text.lower()).strip("-_")
    return name or "case"


def _folder(fmu_file: Path, paths: ProjectPaths, wanted: Path | None) -> Path:
    if wanted is not None:
        check_written(wanted.expanduser())
        return wanted.expanduser().resolve()
    # An FMU that was put into a folder of its own below fmus/ stays there.
    if fmu_file.resolve().parent.parent == paths.fmus.resolve():
        return fmu_file.resolve().parent
    return paths.fmus / case_name(fmu_file.stem)


_NUMBERS = [Column(word, True) for word in ("start", "min", "max")]


def new_case(options: argparse.Namespace, paths: ProjectPaths, console: Console) -> None:
    """Write a case and say what comes next."""
    made = make_case(options, paths)
    mark_project(paths, console)
    case, name = made.case, paths.show(made.files[0])
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


def list_variables(options: argparse.Namespace, console: Console) -> None:
    """Show what an FMU can be given and asked."""
    with _model(options) as (_, fmu, _):
        _list(fmu, options.parameter, console)


def _list(fmu: FmuDescription, named: list[str], console: Console) -> None:
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


def _next_steps(made: MadeCase, paths: ProjectPaths) -> list[str]:
    case, file = made.case, made.files[0]
    data = paths.show((file.parent / case.data).resolve())
    lines = ", ".join(str(number) for number, _ in made.to_edit)
    steps = [f"save {data}/{table}: {_columns(variables)}" for table, variables, _ in case.tables]
    steps.append(f"look at the lines marked EDIT of {paths.show(file)}: {lines}")
    steps += [f"studies {word} {case.place}" for word in ("check", "calibrate")]
    return ["next:", *(f"  {number}. {step}" for number, step in enumerate(steps, start=1))]


def _columns(variables: tuple[FmuVariable, ...], most: int = 8) -> str:
    names = ["time_s", *(axis_label(v.name, v.unit) for v in variables[:most])]
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
