"""What an FMU declares in its modelDescription.xml, as fmpy reads it, in this package's words."""

import io
import math
import zipfile
from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fmpy

from simulation.errors import InputError
from simulation.fmi.variable import (
    SETTERS,
    DefaultExperiment,
    FmiVersion,
    FmuInterface,
    FmuVariable,
    Interface,
)
from simulation.fmi.wine import INSTALL, wine_program
from simulation.foreign_text import shortened
from simulation.units import BASE_UNITS, Unit, UnitDefinition

LAST_REFERENCE = 2**32 - 1  # value references are unsigned 32-bit integers
MOST_ELEMENTS = 1000
"""Of an array that a case can use: longer ones are fields, whose elements have no names of their own."""
# Folders of binaries by FMI version: of this platform, of 64-bit Windows, of 32-bit Windows.
PLATFORM_FOLDERS = {"2.0": fmpy.platform, "3.0": fmpy.platform_tuple}
_WINDOWS = {"2.0": "win64", "3.0": "x86_64-windows"}
_WINDOWS_32 = {"2.0": "win32", "3.0": "x86-windows"}


def binary_for(
    path: Path, version: FmiVersion, interfaces: Mapping[Interface, FmuInterface], names: Collection[str]
) -> dict[Interface, FmuInterface]:
    """Find what of an FMU can be run here: what is for this platform, else what Wine can run.

    Args:
        path: The FMU, for messages.
        version: Its FMI version.
        interfaces: What it declares.
        names: Members of the archive.

    Returns:
        The interfaces that can be run, with their binaries; at least one.

    Raises:
        InputError: If there is none.
    """

    def found(folder: str, ending: str) -> dict[Interface, FmuInterface]:
        """Return the interfaces that have a binary; an FMU may have one for some of them alone."""
        at = {name: f"binaries/{folder}/{one.model_identifier}{ending}" for name, one in interfaces.items()}
        return {name: replace(one, binary=at[name]) for name, one in interfaces.items() if at[name] in names}

    here, windows = PLATFORM_FOLDERS[version], _WINDOWS[version]
    if native := found(here, fmpy.sharedLibraryExtension):
        return native
    for_windows = found(windows, ".dll")
    if "co-simulation" in for_windows and wine_program() is not None:
        return {"co-simulation": for_windows["co-simulation"]}
    if "co-simulation" in for_windows:
        raise InputError(
            f"{path}: its binary is for Windows (binaries/{windows}), which Wine can run here; "
            f"{INSTALL}, or export or compile the FMU for {here}"
        )
    identifier = shortened(next(iter(interfaces.values())).model_identifier)
    why = f"binaries/{here}/{identifier}{fmpy.sharedLibraryExtension} is missing"
    if for_windows:
        why = "the one for Windows is for model exchange, and Wine runs co-simulation"
    elif found(_WINDOWS_32[version], ".dll"):
        why = "the one for Windows is a 32-bit one"
    raise InputError(f"{path}: no binary for this platform ({why}); export or compile it for {here}")


def unit_of(unit: Any) -> UnitDefinition:
    """Convert a unit definition of fmpy; a base unit without a factor counts as none."""
    base = unit.baseUnit
    return UnitDefinition(
        base=None
        if base is None or not base.factor
        else Unit.of({name: int(getattr(base, name)) for name in BASE_UNITS}, base.factor, base.offset),
        displayed={
            str(shown.name): (shown.factor, shown.offset)
            for shown in unit.displayUnits
            if shown.factor and math.isfinite(shown.factor) and math.isfinite(shown.offset)
        },
    )


def read_model(path: Path, content: bytes) -> Any:
    """Read the description; what breaks a rule of the standard that does not matter here is no obstacle."""
    try:
        # From memory: fmpy leaves the file open when the description is not valid.
        model = fmpy.read_model_description(io.BytesIO(content), validate=False)
        _leave_out_inverse_units(model, content)
    except Exception as error:  # fmpy raises plain exceptions of many kinds
        said = shortened(" ".join(str(error).split()))
        raise InputError(f"{path}: its modelDescription.xml is not valid ({said}); export it again") from None
    return model


def _leave_out_inverse_units(model: Any, content: bytes) -> None:
    """Drop inverse display units, which fmpy overlooks: no factor and offset make seconds of hertz."""
    if str(model.fmiVersion) == "2.0":
        return
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        root = ElementTree.fromstring(archive.read("modelDescription.xml"))
    inverse = {
        (unit.get("name"), shown.get("name"))
        for unit in root.iterfind("UnitDefinitions/Unit")
        for shown in unit.iterfind("DisplayUnit")
        if shown.get("inverse") in ("true", "1")
    }
    for unit in model.unitDefinitions:
        unit.displayUnits = [one for one in unit.displayUnits if (unit.name, one.name) not in inverse]


def version_of(path: Path, said: str) -> FmiVersion:
    """Return the FMI version as one that can be run; InputError where it is none of them."""
    if said == "2.0":
        return "2.0"
    # 3.0.1 and 3.0.2 are corrections of the text.
    if said.split(".")[:2] == ["3", "0"]:
        return "3.0"
    raise InputError(f"{path}: speaks FMI {shortened(said)}; export it as FMI 2.0 or 3.0")


def interface_of(declared: Any) -> FmuInterface:
    """Convert an interface of fmpy."""
    return FmuInterface(
        model_identifier=str(declared.modelIdentifier),
        can_be_instantiated_only_once_per_process=bool(declared.canBeInstantiatedOnlyOncePerProcess),
        needs_execution_tool=bool(declared.needsExecutionTool),
    )


def experiment_of(declared: Any, *, unit_s: float) -> DefaultExperiment:
    """Convert the default experiment of fmpy, None for none.

    Args:
        declared: What fmpy read.
        unit_s: How long the unit of the FMU's own time is, which its times count in. [s]
    """

    def said(name: str) -> float | None:
        return number_or_none(getattr(declared, name, None))

    times = (said(name) for name in ("startTime", "stopTime", "stepSize"))
    start_s, stop_s, step_s = (None if time is None else time * unit_s for time in times)
    return DefaultExperiment(start_s, stop_s, step_s, said("tolerance"))


def variable_of(variable: Any, version: FmiVersion) -> FmuVariable:
    """Convert a variable of fmpy, with what its declared type adds."""
    declared = variable.declaredType
    reference = int(variable.valueReference)
    if not 0 <= reference <= LAST_REFERENCE:
        raise ValueError(f"{variable.name} has the value reference {reference}")
    causality = str(variable.causality or "local")

    def said(attribute: str) -> Any:
        return getattr(variable, attribute) or getattr(declared, attribute, None)

    setter, dtype = SETTERS[version].get(str(variable.type), ("", None))
    is_difference = variable.relativeQuantity
    # Not by `said`: a False of the variable holds against a True of its type.
    if is_difference is None:
        is_difference = getattr(declared, "relativeQuantity", None)
    return FmuVariable(
        name=str(variable.name),
        reference=reference,
        causality=causality,
        kind=str(variable.type),
        unit=str(said("unit") or ""),
        start=number_or_none(variable.start),
        minimum=number_or_none(said("min")),
        maximum=number_or_none(said("max")),
        description=str(variable.description or ""),
        is_difference=bool(is_difference),
        variability=str(variable.variability or ("fixed" if causality == "parameter" else "continuous")),
        initial=str(variable.initial or ""),
        start_text="" if variable.start is None else str(variable.start),
        shape=tuple(int(size) for size in variable.shape or ()),
        items={
            str(item.name): int(item.value)
            for item in getattr(declared, "items", ())
            if item.value is not None
        },
        setter=setter,
        dtype=dtype,
    )


def elements_of(variable: Any, version: FmiVersion) -> tuple[FmuVariable, ...]:
    """Convert a variable of fmpy: an array of a fixed size becomes its elements.

    One whose size a structural parameter says stays an array, which no case can use, and so does a long one.
    """
    one = variable_of(variable, version)
    is_fixed = all(dimension.start is not None for dimension in variable.dimensions or ())
    is_used = is_fixed and one.dtype is not None and 0 < math.prod(one.shape) <= MOST_ELEMENTS
    return one.elements if is_used else (one,)


def number_or_none(text: object) -> float | None:
    """Return a finite number, None for anything else; XML can write NaN and infinities."""
    try:
        value = float(str(text))
    except ValueError:
        return None
    return value if math.isfinite(value) else None
