"""The best calibration of a case as the values of its FMU's variables, and as files of them.

Other programs read SSV, Modelica, CSV and JSON, or an FMU with other start values.
"""

import csv
import io
import json
import re
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np

from simulation.case import Case, of_experiment
from simulation.errors import InputError
from simulation.fmi.variable import REAL_KINDS, FmuVariable, Value
from simulation.foreign_file import (
    CASE,
    FMU,
    archive_errors,
    check_members,
    parse_toml,
    read_limited,
    read_text,
)
from simulation.foreign_text import not_a_formula, quoted, shortened
from simulation.units import in_si
from studies.paths import ProjectPaths
from studies.project import FinishedCalibration, Project, best_calibrations
from studies.results.provenance import Provenance, case_of, read_provenance
from studies.templates import environment
from studies.words.wording import listed, square_of


@dataclass(frozen=True)
class SetValue:
    """The value of one variable.

    Attributes:
        variable: The FMU's variable.
        value: Its value; the number of an item for an enumeration. [unit]
        unit: Unit of the FMU, or of the case where the FMU declares none; "" for none.
        origin: "calibrated" or "fixed".
    """

    variable: FmuVariable
    value: Value
    unit: str
    origin: str

    @property
    def name(self) -> str:
        """Name of the variable."""
        return self.variable.name

    @property
    def text(self) -> str:
        """The value as XML writes it, with all digits of a number."""
        return str(self.value).lower() if isinstance(self.value, bool) else str(self.value)


@dataclass(frozen=True)
class CalibratedValues:
    """What sets an FMU as the best calibration of a case did.

    Attributes:
        case: The case.
        finished: The calibration.
        values: Calibrated parameters, then what the case holds under [fixed].
        stale: What was changed since they were calibrated, in one line; "" for nothing.
    """

    case: Case
    finished: FinishedCalibration
    values: tuple[SetValue, ...]
    stale: str = ""

    @property
    def about(self) -> dict[str, Any]:
        """What made the values, as JSON values."""
        changed = {"made_before_change_of": [*self.finished.changed_since]}
        error = self.finished.found.error_name.lower().replace(" ", "_")
        return {
            "case": self.case.name,
            **({"experiment": self.case.experiment} if self.case.experiment else {}),
            "case_digest": self.case.digest,
            "command": str(self.finished.outcome.provenance["command"]),
            "finished": self.finished.outcome.finished,
            error: self.finished.found.mse,
            f"{error}_unit": square_of(self.finished.found.output_unit),
            **(changed if self.finished.changed_since else {}),
        }

    @property
    def sentence(self) -> str:
        """The same in one line."""
        return shortened(", ".join(f"{name}: {value}" for name, value in self.about.items()), 1000)


def calibrated_values(project: Project, experiment: str | None = None) -> CalibratedValues:
    """Return the best calibration of the one case of a project.

    Args:
        project: What the project holds of the case.
        experiment: Which of its experiments; None where it has none.

    Raises:
        InputError: There is none, there are several cases, or the case is not as it was calibrated.
    """
    best = best_calibrations(project)
    if len(best) != 1:
        cases = ", ".join(one.found.case for one in best)
        remedy = f"name one of: {cases}" if cases else "type studies calibrate first"
        raise InputError(f"--write needs one calibrated case; {remedy}")
    return values_of(project.paths, best[0], experiment)


def values_of(
    paths: ProjectPaths, finished: FinishedCalibration, experiment: str | None = None
) -> CalibratedValues:
    """Return the values of a calibration.

    Args:
        paths: Its project.
        finished: The calibration.
        experiment: Which of its experiments; None where it has none.

    Raises:
        InputError: The case is not as it was calibrated.
    """
    made = read_provenance(finished.outcome.provenance, finished.name)
    case = case_of(paths, made, exactly=False)
    stale = _stale(made, case, finished.changed_since)
    case, columns = of_experiment(case, experiment, needed_for="--write")
    space, fmu = case.parameter_space, case.fmu
    theta = np.array([*finished.found.theta.values()])[columns]
    units = {one.name: one.unit for one in space.parameters}
    variables = [fmu.variables[name] for name in case.settings.set_names]
    in_fmu = case.settings.parameters_for_fmu(theta).tolist()
    values = [
        SetValue(variable, value, variable.unit or units.get(variable.name, ""), "calibrated")
        for variable, value in zip(variables, in_fmu, strict=True)
    ]
    fixed = ((fmu.variables[name], value) for name, value in case.fixed.items())
    values += [SetValue(variable, value, variable.unit, "fixed") for variable, value in fixed]
    return CalibratedValues(case, finished, tuple(values), stale)


def _stale(made: Provenance, case: Case, changed_since: Sequence[str]) -> str:
    """Say what was changed since a calibration, whether or not it would move the values."""
    now = read_text(case.path, CASE)
    before, after = (parse_toml(text, str(case.path)) for text in (made.case_text, now))
    keys = [key for key in {**before, **after} if before.get(key) != after.get(key)]
    inside = f" ({', '.join(keys)})" if keys else ""
    changed = [f"{name}{inside}" if name == case.path.name else name for name in changed_since]
    # Data outside the project are seen by what is compared alone.
    if not changed and made.measurement_digest != case.measurement.digest:
        changed = ["the measured values or their weights"]
    return f"calibrated before {listed(changed)} changed; to calibrate anew: {made.command}" * bool(changed)


# A quoted identifier, or what stands between two dots; an element of an array is neither.
_SEGMENT = r"'(?:\\.|[^'\\])+'|[^.'\[\]()]+"
_NAME = re.compile(rf"(?:{_SEGMENT})(?:\.(?:{_SEGMENT}))*")
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*|'.*'")
Binding = tuple[Sequence[str], str]
"""Identifiers that lead to a variable, and its value."""


COLUMNS = ("name", "value", "unit", "origin")


def as_json(found: CalibratedValues) -> bytes:
    """Return a JSON document with name, value, unit and origin of each value, and what made them."""
    values = [{name: getattr(one, name) for name in COLUMNS} for one in found.values]
    return f"{json.dumps({**found.about, 'values': values}, indent=2)}\n".encode()


def as_csv(found: CalibratedValues) -> bytes:
    """Return a table of name, value, unit and origin; what made them stands in a comment before it."""
    text = io.StringIO()
    # A spreadsheet takes each part between commas for a cell.
    text.write(f"# {','.join(map(not_a_formula, found.sentence.split(',')))}\n")
    table = csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    table.writerow(COLUMNS)
    for one in found.values:
        cells = (getattr(one, name) for name in COLUMNS)
        table.writerow([not_a_formula(cell) if isinstance(cell, str) else cell for cell in cells])
    return text.getvalue().encode()


def as_ssv(found: CalibratedValues) -> bytes:
    """Return a parameter set of System Structure Parameter Values 1.0 (SSP 1.0)."""
    # A unit must be defined in the file; without one the variable's own holds, and it is the same.
    said = [one.unit for one in found.values if one.unit and _ssv_kind(one) == "Real"]
    units = {name: unit for name in said if (unit := in_si(name, found.case.fmu.units)) is not None}
    templates = environment("exports")
    templates.filters |= {"attribute": quoteattr, "kind": _ssv_kind}
    return templates.get_template("values.ssv.jinja").render(found=found, units=units).encode()


def _ssv_kind(one: SetValue) -> str:
    """Return the SSV element of a value; an enumeration's number is what FMUs take for its item."""
    if one.variable.kind in REAL_KINDS:
        return "Real"
    return one.variable.kind if one.variable.kind in ("Boolean", "String") else "Integer"


def as_modelica(found: CalibratedValues) -> bytes:
    """Return a Modelica model that extends the FMU's model and modifies its parameters.

    Raises:
        InputError: Modelica has no modifier for a variable of this name.
    """
    bindings: list[Binding] = []
    lines = [f"// {found.sentence}"]
    for one in found.values:
        path, value = identifiers(one.name), one.text
        if one.variable.items:
            lines.append(
                f"// not set: {shortened(one.name)} = item {value}, whose type the FMU does not name"
            )
        elif one.variable.is_start_value:
            bindings += [([*path, "start"], value), ([*path, "fixed"], "true")]
        else:
            bindings.append(
                (path, json.dumps(value, ensure_ascii=False) if isinstance(one.value, str) else value)
            )
    name = "Calibrated_" + re.sub(r"\W", "_", found.case.name, flags=re.ASCII)
    base = ".".join(identifiers(found.case.fmu.model_name))
    lines += [f"model {name}", f"  extends {base}(", f"{_modifiers(bindings, '    ')});", f"end {name};", ""]
    return "\n".join(lines).encode()


def identifiers(name: str) -> list[str]:
    """Split a name of an FMU into Modelica's identifiers, quoted where they need it.

    Raises:
        InputError: Modelica has no such identifier, or it is an element of an array.
    """
    if not (_NAME.fullmatch(name) and name.isascii() and name.isprintable()):
        raise InputError(f"{quoted(name)}: Modelica has no modifier for such a name; use --write ssv")
    return [
        one if _IDENTIFIER.fullmatch(one) else "'" + one.replace("\\", "\\\\") + "'"
        for one in re.findall(_SEGMENT, name)
    ]


def _modifiers(bindings: Sequence[Binding], indent: str) -> str:
    """Return the text of modifiers; those of one component stand in one pair of brackets."""
    lines = []
    for name in dict.fromkeys(path[0] for path, _ in bindings):
        below = [(path[1:], value) for path, value in bindings if path[0] == name]
        own = "".join(f" = {value}" for path, value in below if not path)
        parts = [(path, value) for path, value in below if path]
        inner = f"(\n{_modifiers(parts, indent + '  ')})" if parts else ""
        lines.append(f"{indent}{name}{inner}{own}")
    return ",\n".join(lines)


DESCRIPTION = "modelDescription.xml"


def as_fmu(found: CalibratedValues) -> bytes:
    """Return the case's FMU whose description has the values as start values.

    The binary keeps its own defaults: whether they are replaced at the start is the importer's choice.

    Raises:
        InputError: The FMU is gone or damaged.
    """
    path, packed = found.case.fmu.path, io.BytesIO()
    with (
        archive_errors(path),
        zipfile.ZipFile(io.BytesIO(read_limited(path, FMU))) as old,
        zipfile.ZipFile(packed, "w") as new,
    ):
        check_members(old.infolist(), str(path))
        for member in old.infolist():
            content = old.read(member)
            if member.filename == DESCRIPTION:
                content = _with_start_values(content, found)
            kept = zipfile.ZipInfo(member.filename, member.date_time)
            kept.compress_type, kept.create_system = member.compress_type, member.create_system
            kept.external_attr = member.external_attr  # which of them are programs
            new.writestr(kept, content)
    return packed.getvalue()


def _with_start_values(description: bytes, found: CalibratedValues) -> bytes:
    builder = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(description, ElementTree.XMLParser(target=builder))
    values = {one.name: one for one in found.values}
    for element in root.iterfind("ModelVariables/*"):
        one = values.get(name := element.get("name", ""))
        if elements := [
            each for each in found.values if each.variable.array and each.name.rpartition("[")[0] == name
        ]:
            words = element.get("start", "").split() or ["0"]
            words *= len(elements[0].variable.array) // len(words)
            for each in elements:
                words[each.variable.element] = each.text
            element.set("start", " ".join(words))
        if one is None:
            continue
        if found.case.fmu.fmi_version == "2.0":
            place, attribute = element.find(one.variable.kind), "start"
        elif one.variable.kind == "String":
            place, attribute = element.find("Start"), "value"
        else:
            place, attribute = element, "start"
        assert place is not None, "the description was read with this variable"
        place.set(attribute, one.text)
    # XML has no two hyphens in a comment.
    root.insert(0, ElementTree.Comment(f" {found.sentence.replace('--', '- -')} "))
    changed: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return changed
