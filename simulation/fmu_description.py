"""What an FMU says about itself: variables, units, binaries; read without unpacking it."""

import difflib
import hashlib
import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import fmpy

from simulation.errors import InputError


@dataclass(frozen=True)
class FmuVariable:
    """One variable of the model description.

    Attributes:
        name: Name.
        reference: Value reference.
        causality: "parameter", "input", "output", "local", ...
        kind: "Real", "Integer", "Boolean", "String" or "Enumeration".
        unit: Declared unit, "" for none.
        start: Start value, None when it has none or is no number. [unit]
        minimum: Declared minimum, None for none. [unit]
        maximum: Declared maximum, None for none. [unit]
        description: What the variable means, "" for nothing said.
    """

    name: str
    reference: int
    causality: str
    kind: str
    unit: str
    start: float | None
    minimum: float | None
    maximum: float | None
    description: str


@dataclass(frozen=True)
class FmuDescription:
    """The part of a model description that a co-simulation needs.

    Attributes:
        path: The FMU.
        guid: Identity that ties the description to the binary.
        model_identifier: Name of the binary.
        model_name: Name of the model.
        generation_tool: Tool that made the FMU, "" for nothing said.
        sha256: SHA-256 of the FMU's bytes, in hexadecimal.
        platforms: Platforms the FMU has a binary for.
        variables: All variables by name.
    """

    path: Path
    guid: str
    model_identifier: str
    model_name: str
    generation_tool: str
    sha256: str
    platforms: tuple[str, ...]
    variables: Mapping[str, FmuVariable]

    @cached_property
    def _names_by_causality(self) -> dict[str, list[str]]:
        names: dict[str, list[str]] = {}
        for variable in self.variables.values():
            names.setdefault(variable.causality, []).append(variable.name)
        return names

    def names(self, causality: str) -> tuple[str, ...]:
        """List the variables of a causality in the order of the description.

        Args:
            causality: "parameter", "input", "output", "local", ...

        Returns:
            Their names.
        """
        return tuple(self._names_by_causality.get(causality, []))

    def require(self, name: str, causality: str, where: str) -> FmuVariable:
        """Find a Real variable of a given causality.

        Args:
            name: Name of the variable.
            causality: What it must be.
            where: What asks for it, for the message.

        Returns:
            The variable.

        Raises:
            InputError: If there is none of this name, or it is something else.
        """
        variable = self.variables.get(name)
        if variable is None:
            candidates = self.names(causality)
            close = difflib.get_close_matches(name, candidates, n=1, cutoff=0.5)
            if not close:
                by_lower = {candidate.lower(): candidate for candidate in candidates}
                close = [by_lower[name.lower()]] if name.lower() in by_lower else []
            hint = f"did you mean {close[0]}?" if close else f"its {causality}s: {_listed(candidates)}"
            raise InputError(f"{where}: {self.path.name} has no {causality} named {name}; {hint}")
        if variable.causality != causality:
            raise InputError(
                f"{where}: {name} is a {variable.causality} of {self.path.name}, not its {causality}; "
                f"choose one of: {_listed(self.names(causality))}"
            )
        if variable.kind != "Real":
            raise InputError(f"{where}: {name} is of type {variable.kind}; only Real variables can be used")
        return variable


def read_description(path: Path) -> FmuDescription:
    """Read the model description of an FMI 2.0 co-simulation FMU.

    Args:
        path: The FMU.

    Returns:
        Its description.

    Raises:
        InputError: If the file is missing, no FMU, of another FMI version, without co-simulation, or has no
            binary for this platform.
    """
    try:
        content = path.read_bytes()
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.namelist()
    except FileNotFoundError:
        raise InputError(
            f"{path}: no such file; correct `fmu` in the case file or put the FMU there"
        ) from None
    except (OSError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not an FMU ({error}); export it again, an FMU is a zip archive") from None
    if "modelDescription.xml" not in members:
        raise InputError(f"{path}: not an FMU (no modelDescription.xml inside); export it again")
    try:
        # From memory: fmpy leaves the file open when the description is not valid.
        model: Any = fmpy.read_model_description(io.BytesIO(content))
    except Exception as error:  # fmpy raises plain exceptions of many kinds
        said = " ".join(str(error).split())
        raise InputError(f"{path}: its modelDescription.xml is not valid ({said}); export it again") from None
    if model.fmiVersion != "2.0":
        raise InputError(f"{path}: speaks FMI {model.fmiVersion}; export it as FMI 2.0 co-simulation")
    if model.coSimulation is None:
        raise InputError(f"{path}: has no co-simulation interface; export it as FMI 2.0 co-simulation")
    identifier = str(model.coSimulation.modelIdentifier)
    platforms = tuple(
        sorted(
            {
                part[1]
                for part in (name.split("/") for name in members)
                if part[0] == "binaries" and len(part) > 2
            }
        )
    )
    binary = f"binaries/{fmpy.platform}/{identifier}{fmpy.sharedLibraryExtension}"
    if binary not in members:
        held = f"it has one for {', '.join(platforms)}" if platforms else "it has none at all"
        raise InputError(
            f"{path}: no binary for this platform ({binary} is missing, {held}); "
            f"export or compile it for {fmpy.platform}"
        )
    return FmuDescription(
        path=path,
        guid=str(model.guid),
        model_identifier=identifier,
        model_name=str(model.modelName),
        generation_tool=str(model.generationTool or ""),
        sha256=hashlib.sha256(content).hexdigest(),
        platforms=platforms,
        variables={str(variable.name): _variable(variable) for variable in model.modelVariables},
    )


def _variable(variable: Any) -> FmuVariable:
    declared = variable.declaredType
    return FmuVariable(
        name=str(variable.name),
        reference=int(variable.valueReference),
        causality=str(variable.causality or "local"),
        kind=str(variable.type),
        unit=str(variable.unit or (declared.unit if declared is not None else None) or ""),
        start=_number(variable.start),
        minimum=_number(variable.min or (declared.min if declared is not None else None)),
        maximum=_number(variable.max or (declared.max if declared is not None else None)),
        description=str(variable.description or ""),
    )


def _number(text: object) -> float | None:
    try:
        return float(str(text))
    except ValueError:
        return None


def _listed(names: tuple[str, ...], most: int = 20) -> str:
    if not names:
        return "none"
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")
