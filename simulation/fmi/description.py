"""What an FMU says about itself: variables, units, interfaces, binaries; read without unpacking it."""

import difflib
import hashlib
import io
import zipfile
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.fmi import fmpy_description as reading
from simulation.fmi.own_time import clock_of
from simulation.fmi.variable import (
    REAL_KINDS,
    SETTERS,
    DefaultExperiment,
    FmiVersion,
    FmuInterface,
    FmuVariable,
    Interface,
)
from simulation.foreign_file import DESCRIPTION, EVENT_INDICATORS, FMU, check_members, identity, read_limited
from simulation.foreign_text import shortened
from simulation.units import UnitDefinition


@dataclass(frozen=True)
class FmuDescription:
    """What a model description says, as far as running the FMU needs it.

    Attributes:
        path: The FMU.
        guid: Identity that ties the description to the binary.
        model_name: Name of the model.
        generation_tool: Tool that made the FMU, "" for nothing said.
        sha256: SHA-256 of the FMU's bytes, in hexadecimal.
        variables: All variables by name.
        fmi_version: "2.0" or "3.0".
        interfaces: Interfaces by name, "co-simulation" or "model-exchange"; at least one.
        default_experiment: What it suggests for a simulation.
        states: Names of the continuous states (model exchange), in the order of the FMU.
        derivatives: Names of their derivatives, in the same order.
        depends_on: Variables that each of these may depend on, by its name, where it is said.
        n_event_indicators: Functions whose change of sign is an event (model exchange).
        units: What it says of its units, by their names.
    """

    path: Path
    guid: str
    model_name: str
    generation_tool: str
    sha256: str
    variables: Mapping[str, FmuVariable]
    fmi_version: FmiVersion
    interfaces: Mapping[str, FmuInterface]
    default_experiment: DefaultExperiment = field(default_factory=DefaultExperiment)
    states: tuple[str, ...] = ()
    derivatives: tuple[str, ...] = ()
    depends_on: Mapping[str, frozenset[str]] = field(default_factory=dict)
    n_event_indicators: int = 0
    units: Mapping[str, UnitDefinition] = field(default_factory=dict)

    def names(self, causality: str) -> tuple[str, ...]:
        """List the variables of a causality in the order of the description.

        Args:
            causality: "parameter", "input", "output", "local", ...

        Returns:
            Their names.
        """
        return tuple(one.name for one in self.variables.values() if one.causality == causality)

    @property
    def usual_interface(self) -> Interface:
        """How it is run by default: by its own solver, where it has one."""
        return "co-simulation" if "co-simulation" in self.interfaces else "model-exchange"

    def interface(self, name: str, where: str) -> FmuInterface:
        """Find an interface.

        Args:
            name: "co-simulation" or "model-exchange".
            where: What asks for it, for the message.

        Returns:
            The interface.

        Raises:
            InputError: If the FMU does not have it.
        """
        if name in self.interfaces:
            return self.interfaces[name]
        other = next(iter(self.interfaces))
        raise InputError(
            f"{where}: {self.path.name} has no {name} interface; "
            f'write interface = "{other}" in the case file, or export it for {name}'
        )

    def require(self, name: str, causality: str, where: str, *, may_be_input: bool = False) -> FmuVariable:
        """Find a real scalar of a given causality; an input may also be a whole number or true or false.

        Args:
            name: Name of the variable.
            causality: What it must be; a "parameter" may also be a start value (an initial state), an
                "output" a local variable.
            where: What asks for it, for the message.
            may_be_input: Whether it may also be an input, which is set once and stays.

        Returns:
            The variable.

        Raises:
            InputError: If there is none of this name, or it is something else.
        """
        variable = self.find(name, causality, where, may_be_input=may_be_input)
        # The loops read outputs into an array of doubles.
        # No Float32, whose values are half as wide.
        usable = ("Real", "Float64") if causality == "output" else REAL_KINDS
        if variable.kind not in usable and not (causality == "input" and variable.dtype is not None):
            remedy = "choose another" if causality == "output" else "hold it under [fixed]"
            if causality == "parameter" and variable.kind != "String":
                remedy += ", in a case for each value, and compare their errors"
            numbers = " or ".join(kind for kind in usable if kind in SETTERS[self.fmi_version])
            raise InputError(
                f"{where}: {name} is of type {variable.kind}; only {numbers} variables can be used, {remedy}"
            )
        return variable

    def find(self, name: str, causality: str, where: str, *, may_be_input: bool = False) -> FmuVariable:
        """Find a scalar of any type and a given causality.

        Args:
            name: Name of the variable.
            causality: What it must be; a "parameter" may also be a structural one or a start value, an
                "output" a local variable, as many tools declare no others.
            where: What asks for it, for the message.
            may_be_input: Whether it may also be an input, to be held at a value.

        Returns:
            The variable.

        Raises:
            InputError: If there is none of this name or more than one, it has another causality, or no case
                can use it.
        """
        variable = self.variables.get(name)
        if variable is None:
            candidates = self.names(causality) + (self.names("local") if causality == "output" else ())
            by_lower = {candidate.lower(): candidate for candidate in candidates}
            close = difflib.get_close_matches(name.lower(), by_lower, n=1, cutoff=0.5)
            hint = f"did you mean {by_lower[close[0]]}?" if close else f"it has: {_listed(candidates)}"
            raise InputError(f"{where}: {self.path.name} has no {causality} named {name}; {hint}")
        variable.require_once(f"{where}: {self.path.name}")
        stands_in = causality == "output" and variable.causality == "local"
        stands_in |= causality == "parameter" and (
            variable.is_start_value
            or variable.causality == "structuralParameter"
            or (may_be_input and variable.causality == "input")
        )
        if variable.causality != causality and not stands_in:
            article = "an" if variable.causality[0] in "aeiou" else "a"
            what = f"{shortened(name)} is {article} {variable.causality} of {self.path.name}, not {causality}"
            # A state's start is a parameter only where the FMU declares one.
            remedy = "to change its start, begin earlier (start_d), or " * (causality == "parameter")
            raise InputError(f"{where}: {what}; {remedy}choose one of: {_listed(self.names(causality))}")
        if variable.is_out_of_reach:
            size = " x ".join(map(str, variable.shape))
            what = f"a {variable.kind} of {self.path.name}, which no case can use"
            if size:
                what = (
                    f"an array ({size}) of {self.path.name}, whose elements no case can use: its size is a "
                    f"structural parameter, or above {reading.MOST_ELEMENTS}"
                )
            raise InputError(f"{where}: {name} is {what}; leave it out")
        return variable


# The descriptions that this process has read, by the identity of their files.
_read: dict[tuple[object, ...], "FmuDescription"] = {}


def known_description(path: Path) -> FmuDescription:
    """Return what `read_description` does; a file that has not changed since is not read again.

    Args:
        path: The FMU.

    Raises:
        InputError: As `read_description`.
    """
    try:
        key = identity(path)
    except OSError:
        return read_description(path)
    if key not in _read:
        _read[key] = read_description(path)
    return _read[key]


def read_description(path: Path) -> FmuDescription:
    """Read the model description of an FMI 2.0 or 3.0 FMU.

    Args:
        path: The FMU.

    Returns:
        Its description, with the interfaces that can be run on this platform.

    Raises:
        InputError: If the file is missing, no FMU, of another FMI version, without co-simulation and model
            exchange, or has no binary for this platform.
    """
    # Read once: digest, table of contents and description are of the same bytes.
    content = read_limited(path, FMU, if_missing="correct `fmu` in the case file or put the FMU there")
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not an FMU ({error}); export it again, an FMU is a zip archive") from None
    check_members(members, str(path))
    sizes = {member.filename: member.file_size for member in members}
    if "modelDescription.xml" not in sizes:
        raise InputError(f"{path}: not an FMU (no modelDescription.xml inside); export it again")
    # Before it is unpacked: a small archive may hold a vast description.
    DESCRIPTION.check(sizes["modelDescription.xml"] / 1e6, str(path))
    model = reading.read_model(path, content)
    try:
        return _described(path, content, model, names=sizes)
    except InputError:
        raise
    # fmpy checks no values: what a conversion raises here is a fault of the file.
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(
            f"{path}: its modelDescription.xml is not valid ({shortened(str(error))}); export it again"
        ) from None


def _described(path: Path, content: bytes, model: Any, *, names: Collection[str]) -> FmuDescription:
    """Take what fmpy read into this package's types, whose values need no further look.

    Raises:
        InputError: If nothing here can run it, or a number in it is absurd.
        Exception: If something in it is not what its name promises.
    """
    version = reading.version_of(path, str(model.fmiVersion))
    declared: dict[Interface, Any] = {
        "co-simulation": model.coSimulation,
        "model-exchange": model.modelExchange,
    }
    interfaces = {name: reading.interface_of(one) for name, one in declared.items() if one is not None}
    if not interfaces:
        raise InputError(
            f"{path}: has no co-simulation and no model exchange interface; export it for co-simulation"
        )
    runnable = reading.binary_for(path, version, interfaces, names)
    n_event_indicators = int(model.numberOfEventIndicators)
    if n_event_indicators < 0:
        raise ValueError(f"{n_event_indicators} event indicators")
    EVENT_INDICATORS.check(n_event_indicators, str(path))
    derivatives = [one.variable for one in model.derivatives if one.variable.derivative is not None]
    found = [(str(each.name), reading.elements_of(each, version)) for each in model.modelVariables]
    variables = _by_name(one for _, elements in found for one in elements)
    names = {name: tuple(one.name for one in elements) for name, elements in found}
    units = {str(unit.name): reading.unit_of(unit) for unit in model.unitDefinitions}
    return FmuDescription(
        path=path,
        guid=str(model.guid),
        model_name=str(model.modelName),
        generation_tool=str(model.generationTool or ""),
        sha256=hashlib.sha256(content).hexdigest(),
        variables=variables,
        fmi_version=version,
        interfaces={**runnable},
        default_experiment=reading.experiment_of(
            model.defaultExperiment, unit_s=clock_of(variables, units).unit_s or 1.0
        ),
        states=tuple(name for one in derivatives for name in names[str(one.derivative.name)]),
        derivatives=tuple(name for one in derivatives for name in names[str(one.name)]),
        depends_on={
            element: frozenset(name for one in unknown.dependencies for name in names[str(one.name)])
            for unknown in model.derivatives
            for element in names[str(unknown.variable.name)]
            # By the standard, None is "may depend on all", and an empty list "on nothing".
            if unknown.dependencies is not None
        },
        n_event_indicators=n_event_indicators,
        units=units,
    )


def _by_name(variables: Iterable[FmuVariable]) -> dict[str, FmuVariable]:
    """Return variables by name, the last one of a name with the references of those before."""
    found = dict[str, FmuVariable]()
    for one in variables:
        before = found.get(one.name)
        if before is not None:
            one = replace(one, namesakes=(*before.namesakes, before.reference))
        found[one.name] = one
    return found


def _listed(names: tuple[str, ...]) -> str:
    more = ", ..." if len(names) > 20 else ""
    return ", ".join(shortened(name, 60) for name in names[:20]) + more or "none"
