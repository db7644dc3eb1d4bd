"""Values as texts that other programs read: SSV, Modelica, CSV and JSON."""

import csv
import io
import json
import re
from collections.abc import Sequence
from typing import Final
from xml.etree import ElementTree

from simulation.errors import InputError
from simulation.fmi.variable import REAL_KINDS
from simulation.foreign_text import quoted, shortened
from simulation.units import in_si
from studies.exports.calibrated_values import CalibratedValues, SetValue

_SSP: Final = "http://ssp-standard.org/SSP1/SystemStructure"
# A quoted identifier, or what stands between two dots; an element of an array is neither.
_SEGMENT: Final = r"'(?:\\.|[^'\\])+'|[^.'\[\]()]+"
_NAME: Final = re.compile(rf"(?:{_SEGMENT})(?:\.(?:{_SEGMENT}))*")
_IDENTIFIER: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*|'.*'")
Binding = tuple[Sequence[str], str]
"""Identifiers that lead to a variable, and its value."""


def as_json(found: CalibratedValues) -> bytes:
    """Return a JSON document with name, value, unit and origin of each value, and what made them."""
    values = [
        {"name": one.name, "value": one.value, "unit": one.unit, "origin": one.origin} for one in found.values
    ]
    return f"{json.dumps({**found.about, 'values': values}, indent=2)}\n".encode()


def as_csv(found: CalibratedValues) -> bytes:
    """Return a table of name, value, unit and origin; what made them stands in a comment before it."""
    text = io.StringIO()
    text.write(f"# {found.sentence}\n")
    table = csv.writer(text, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
    table.writerow(["name", "value", "unit", "origin"])
    table.writerows([one.name, one.value, one.unit, one.origin] for one in found.values)
    return text.getvalue().encode()


def as_ssv(found: CalibratedValues) -> bytes:
    """Return a parameter set of System Structure Parameter Values 1.0 (SSP 1.0)."""
    ElementTree.register_namespace("ssv", f"{_SSP}ParameterValues")
    ElementTree.register_namespace("ssc", f"{_SSP}Common")
    values, common = f"{{{_SSP}ParameterValues}}", f"{{{_SSP}Common}}"
    root = ElementTree.Element(
        f"{values}ParameterSet", version="1.0", name=found.case.name, description=found.sentence
    )
    parameters = ElementTree.SubElement(root, f"{values}Parameters")
    units = {}
    for one in found.values:
        parameter = ElementTree.SubElement(
            parameters, f"{values}Parameter", name=one.name, description=one.origin
        )
        kind, attributes = _ssv_kind(one), {"value": one.text}
        # A unit must be defined in the file; without one the variable's own holds, and it is the same.
        if kind == "Real" and one.unit and (unit := in_si(one.unit, found.case.fmu.units)) is not None:
            units[one.unit] = unit
            attributes["unit"] = one.unit
        ElementTree.SubElement(parameter, f"{values}{kind}", attributes)
    if units:
        defined = ElementTree.SubElement(root, f"{values}Units")
        for name, unit in units.items():
            powers = {base: str(power) for base, power in unit.exponents}
            size = {"factor": repr(float(unit.factor)), "offset": repr(float(unit.offset))}
            of = ElementTree.SubElement(defined, f"{common}Unit", name=name)
            ElementTree.SubElement(of, f"{common}BaseUnit", powers | size)
    return _written(root)


def _ssv_kind(one: SetValue) -> str:
    """Return the SSV element of a value; an enumeration's number is what FMUs take for its item."""
    if one.variable.kind in REAL_KINDS:
        return "Real"
    return one.variable.kind if one.variable.kind in ("Boolean", "String") else "Integer"


def _written(root: ElementTree.Element) -> bytes:
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return text


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
