"""The files of a new case: case.toml, its lines that need the user marked EDIT, README and examples."""

import math
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Any

from jinja2 import Environment

from simulation.fmi.description import FmuDescription
from simulation.fmi.own_time import clock_of
from simulation.fmi.variable import REAL_KINDS, FmuVariable, Value
from simulation.foreign_text import toml_text
from studies.new.choice import Choice, Times, bounds_for, inputs_of, other_parameters
from studies.templates import environment

MOST_SHOWN = 40
"""Commented entries of one kind; the rest is given as a number."""
INPUTS_FILE, MEASURED_FILE = "inputs.csv", "measured.csv"
N_EXAMPLE_ROWS = 3


@dataclass(frozen=True)
class NewCase:
    """Everything a new case file says.

    Attributes:
        name: Name of the case.
        place: What the user types to mean the case, quoted for a shell.
        fmu: The FMU.
        fmu_file: The FMU's file, from the case's folder.
        data: The folder of the recordings, from the case's folder.
        interface: How the FMU is run.
        inputs: The inputs that recordings drive.
        outputs: The outputs.
        parameters: The parameters.
        times: The time axis.
        switches: Inputs whose column is there already and has two values.
        fixed: Values of parameters that are not calibrated, as another program said them. [FMU's units]
        noise: Scatter of the columns of outputs that are there already, by name. [FMU's unit]
    """

    name: str
    place: str
    fmu: FmuDescription
    fmu_file: str
    data: str
    interface: str
    inputs: tuple[FmuVariable, ...]
    outputs: Choice
    parameters: Choice
    times: Times
    fixed: Mapping[str, Value] = field(default_factory=dict)
    switches: frozenset[str] = frozenset()
    noise: Mapping[str, float] = field(default_factory=dict)

    @property
    def tables(self) -> list[tuple[str, tuple[FmuVariable, ...], str]]:
        """The CSV files, their variables and what these are."""
        tables = [(INPUTS_FILE, self.inputs, "input"), (MEASURED_FILE, self.outputs.used, "measured")]
        return [table for table in tables if table[1]]


def case_text(case: NewCase) -> str:
    """Return the case file."""
    template, fmu = _environment().get_template("case.toml.jinja"), case.fmu
    held, fixable = (
        [one for one in found if one.name not in case.fixed]
        for found in (inputs_of(fmu, held=True), other_parameters(fmu))
    )
    return template.render(
        case=case,
        fmu=fmu,
        times=case.times,
        clock=clock_of(fmu.variables, fmu.units),
        most=MOST_SHOWN,
        held_inputs=held,
        fixable=fixable,
    )


def data_readme(case: NewCase) -> str:
    """Return the README of the recordings' folder."""
    template = _environment().get_template("README.md.jinja")
    return template.render(case=case, tables=case.tables, examples=list(example_files(case)))


def example_files(case: NewCase) -> dict[str, str]:
    """Return example CSV files by name: the right columns, never typed."""
    step_s = case.times.step_s
    return {file.replace(".csv", ".example.csv"): _csv(used, step_s) for file, used, _ in case.tables}


def lines_to_edit(text: str) -> list[tuple[int, str]]:
    """Return number and content of the lines in use that are marked EDIT."""
    lines = enumerate(text.splitlines(), start=1)
    return [(number, line) for number, line in lines if "# EDIT:" in line and not line.startswith("#")]


@cache
def _environment() -> Environment:
    """Return what fills the templates: text, not HTML."""
    made = environment("new")
    known: dict[str, Any] = made.globals
    known |= {"bounds_for": bounds_for, "reals": REAL_KINDS, "temperatures": ("K", "degC", "°C")}
    made.filters |= {
        "toml": toml_text,
        "line": _line,
        "value": _toml_value,
        "number": _number,
        "quote": shlex.quote,
        "key": _key,
        "comment": _comment,
        "cell": _cell,
        "values": _values,
        "start": _start,
        "declared": _declared,
    }
    return made


def _toml_value(value: Value) -> str:
    """Return a value of [fixed]."""
    if isinstance(value, bool | str):
        return toml_text(value) if isinstance(value, str) else str(value).lower()
    return repr(value)


def _key(name: str) -> str:
    """Return a key of TOML, in quotes where it needs them."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_text(name)


def _comment(block: str) -> str:
    return "\n".join(f"# {line}" for line in block.splitlines())


def _cell(text: str) -> str:
    """Return a text that can stand in a table of Markdown."""
    return _line(text).replace("|", "\\|")


def _line(text: str) -> str:
    """Return a text that can stand in a comment: TOML allows no control character there."""
    return " ".join(re.sub(r"[\x00-\x1f\x7f]", " ", text).split())


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(float(value))


def _values(variable: FmuVariable) -> str:
    """Say which values a variable has that is no real number."""
    if variable.kind == "Boolean":
        return "0 and 1"
    items = ", ".join(f"{number} ({_line(item)})" for item, number in variable.items.items())
    return items or "whole numbers"


def _declared(variable: FmuVariable) -> str:
    """Say the bounds that the FMU declares, as a comment."""
    ends = (("min", variable.minimum), ("max", variable.maximum))
    said = ", ".join(f"{word} {end:g}" for word, end in ends if end is not None and math.isfinite(end))
    words = [f"the FMU's {said}"] * bool(said) + ["a start value"] * variable.is_start_value
    return f"# {'; '.join(words)}" if words else ""


def _start(variable: FmuVariable) -> str:
    """Return a start value that is no real number, as TOML."""
    text = variable.start_text
    if variable.kind == "Boolean":
        return "true" if text.strip().lower() in ("true", "1") else "false"
    return toml_text(text) if variable.kind == "String" else text or "0"


def _csv(variables: tuple[FmuVariable, ...], step_s: float) -> str:
    values = [_example(v) for v in variables]
    lines = [",".join(["time_s", *(_quoted(v.name) for v in variables)])]
    lines += [",".join(f"{value:.10g}" for value in (i * step_s, *values)) for i in range(N_EXAMPLE_ROWS)]
    return "\n".join(lines) + "\n"


def _example(variable: FmuVariable) -> float:
    """Return a value that the variable can have."""
    if variable.start is not None:
        return variable.start
    if variable.kind == "Boolean":
        return float(variable.start_text.strip().lower() == "true")
    return float(next(iter(variable.items.values()), 0))


def _quoted(name: str) -> str:
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"') else name
