"""Values in files that other programs read: SSV, Modelica, CSV, JSON, and an FMU with other start values."""

import csv
import io
import json
import re
import zipfile
from collections.abc import Sequence
from typing import Final
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

from simulation.errors import InputError
from simulation.fmi.variable import REAL_KINDS
from simulation.foreign_file import FMU, check_members, read_limited
from simulation.foreign_text import quoted, shortened
from simulation.units import in_si
from studies.exports.calibrated_values import CalibratedValues, SetValue
from studies.templates import environment

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
    try:
        with (
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
    # RuntimeError: a member is encrypted.
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError) as error:
        raise InputError(f"{path}: cannot be unpacked ({error}); export it again") from None
    return packed.getvalue()


def _with_start_values(description: bytes, found: CalibratedValues) -> bytes:
    builder = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(description, ElementTree.XMLParser(target=builder))
    values = {one.name: one for one in found.values}
    for element in root.iterfind("ModelVariables/*"):
        one = values.get(element.get("name", ""))
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
