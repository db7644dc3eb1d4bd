"""Values of an SSV file, and the FMU with the values of an SSP file, for a new case."""

import io
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path, PurePosixPath
from xml.etree import ElementTree

from simulation.errors import InputError
from simulation.fmi.description import FmuDescription
from simulation.fmi.variable import REAL_KINDS, Value
from simulation.foreign_file import DESCRIPTION, FMU, archive_errors, check_members, read_limited
from simulation.foreign_text import quoted, shortened
from simulation.units import conversion

_SSV = "{http://ssp-standard.org/SSP1/SystemStructureParameterValues}"
_SSD = "{http://ssp-standard.org/SSP1/SystemStructureDescription}"
_STRUCTURE = "SystemStructure.ssd"

Said = Mapping[str, tuple[Value, str]]
"""Values by name, each with its unit; "" for that of the FMU."""


def read_values(path: Path) -> Said:
    """Read an SSV file.

    Raises:
        InputError: If it is none.
    """
    return _values(read_limited(path, DESCRIPTION), str(path))


def unpack_system(path: Path, folder: Path) -> tuple[Path, Said]:
    """Write the FMU of an SSP file into a folder; return it, and the values that the system gives it.

    Raises:
        InputError: If it is no SSP file, has another number of FMUs than one, or maps names.
    """
    content = read_limited(path, FMU)
    if not zipfile.is_zipfile(io.BytesIO(content)):
        raise InputError(f"{path}: is no SSP file, which is a zip archive; export it again")
    with archive_errors(path), zipfile.ZipFile(io.BytesIO(content)) as archive:
        check_members(archive.infolist(), str(path))
        names = archive.namelist()
        if _STRUCTURE not in names:
            raise InputError(f"{path}: is no SSP file (no {_STRUCTURE} inside); export it again")

        def member(source: str) -> bytes:
            if source not in names:
                raise InputError(
                    f"{path}: has no {shortened(source)}, which its system names; export it again"
                )
            return archive.read(source)

        root = _parsed(member(_STRUCTURE), f"{path}: {_STRUCTURE}")
        components = [one for one in root.iter(f"{_SSD}Component") if one.get("source", "").endswith(".fmu")]
        if len(components) != 1:
            raise InputError(
                f"{path}: has {len(components)} FMUs; a case has one: export the system as one FMU"
            )
        values = dict[str, tuple[Value, str]]()
        for binding in root.iter(f"{_SSD}ParameterBinding"):
            if binding.find(f"{_SSD}ParameterMapping") is not None:
                raise InputError(
                    f"{path}: maps names of parameters, which is not read; export values by their names"
                )
            inside = binding.find(f"{_SSD}ParameterValues/{_SSV}ParameterSet")
            source, prefix = binding.get("source", ""), binding.get("prefix", "")
            text = member(source) if source else b"" if inside is None else ElementTree.tostring(inside)
            found = _values(text, f"{path}: {source or _STRUCTURE}") if text else {}
            of_component = f"{components[0].get('name', '')}."
            values |= {f"{prefix}{name}".removeprefix(of_component): one for name, one in found.items()}
        source = components[0].get("source", "")
        fmu = folder / PurePosixPath(source).name
        fmu.write_bytes(member(source))
    return fmu, values


def with_values(fmu: FmuDescription, said: Said, where: str) -> tuple[FmuDescription, dict[str, Value]]:
    """Return the description with values as start values, and these in the FMU's units.

    Args:
        fmu: The description.
        said: The values.
        where: The file that says them, for messages.

    Raises:
        InputError: If the FMU has no such parameter, or a value does not fit it.
    """
    variables, values = dict(fmu.variables), dict[str, Value]()
    for name, (value, unit) in said.items():
        variable = fmu.find(name, "parameter", where, may_be_input=True)
        if variable.kind in REAL_KINDS and isinstance(value, float | int) and not isinstance(value, bool):
            change = conversion(
                unit or variable.unit,
                variable.unit,
                f"{where}: {name}",
                definitions=fmu.units,
                is_difference=variable.is_difference,
            )
            value = float(value) * change.factor + change.offset
        values[name] = value = variable.held_at(value, f"{where}: {name}")
        start = value if variable.kind in REAL_KINDS and isinstance(value, float) else variable.start
        variables[name] = replace(variable, start=start, start_text=str(value))
    return replace(fmu, variables=variables), values


def _parsed(content: bytes, where: str) -> ElementTree.Element:
    DESCRIPTION.check(len(content) / 1e6, where)
    try:
        return ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise InputError(f"{where}: is not valid XML ({error}); export it again") from None


def _values(content: bytes, where: str) -> dict[str, tuple[Value, str]]:
    root, found = _parsed(content, where), dict[str, tuple[Value, str]]()
    if root.tag != f"{_SSV}ParameterSet":
        raise InputError(f"{where}: is no SSV file, whose first element is ParameterSet; export it again")
    for one in root.iter(f"{_SSV}Parameter"):
        name, kind = one.get("name", ""), next(iter(one), None)
        if not name or kind is None or name in found:
            raise InputError(f"{where}: {shortened(name) or 'a parameter'} has no value or two; correct it")
        text, what = kind.get("value", ""), kind.tag.removeprefix(_SSV)
        try:
            value: Value = (
                float(text)
                if what == "Real"
                else int(text)
                if what == "Integer"
                else {"true": True, "1": True, "false": False, "0": False}[text]
                if what == "Boolean"
                else text
            )
        except (ValueError, KeyError):
            raise InputError(
                f"{where}: {shortened(name)} = {quoted(text)} is no {what}; correct it"
            ) from None
        found[name] = value, kind.get("unit", "")
    return found
