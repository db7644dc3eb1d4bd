"""What build.toml in a model's folder says, and the one error of the compiler."""

import tomllib
from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass


class CompileError(ValueError):
    """A model, a build file or a toolchain that cannot be compiled; one line that says why and what to do."""


BUILD_FILE = "build.toml"
# A whole number stays one: descriptions show it as it is written.
_Positive = Annotated[int | float, Field(gt=0)]


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class BuildSettings:
    """Choices of one build.

    Attributes:
        model: Qualified Modelica class, such as ``Office.R7C4Office``.
        solver: ``exact`` (matrix exponential; needs a model that is affine while its inputs are held) or
            ``rk4`` (fourth-order Runge-Kutta with controlled substeps, for any model).
        name: Name of the FMU and its model identifier; empty for the first part of ``model``.
        fmi_version: Version of FMI, ``2.0`` or ``3.0``.
        model_exchange_only: Whether co-simulation is left out.
        events: Whether relations in conditions make events, as Modelica means it; needed for ``when``.
        max_substep_s: Longest substep of ``rk4``, and of the search for events. [s]
        tolerance: Error that ``rk4`` allows per substep, relative to 1 + the magnitude of the state.
        start_time_s: Default start time. [s]
        stop_time_s: Default stop time. [s]
        step_size_s: Default communication step. [s]
    """

    model: str
    solver: Literal["exact", "rk4"] = "rk4"
    name: Annotated[str, Field(pattern=r"^([A-Za-z_][A-Za-z0-9_]*)?$")] = ""
    fmi_version: Literal["2.0", "3.0"] = "2.0"
    model_exchange_only: bool = False
    events: bool = False
    max_substep_s: _Positive = 60.0
    tolerance: _Positive = 1e-9
    start_time_s: int | float = 0.0
    stop_time_s: _Positive = 86400.0
    step_size_s: _Positive = 600.0

    @property
    def identifier(self) -> str:
        """Model identifier: a C name that is also the file name of the FMU."""
        return self.name or self.model.split(".")[0]

    @property
    def is_plain(self) -> bool:
        """Whether the wrapper without events, for FMI 2.0, is enough."""
        return self.fmi_version == "2.0" and not self.events

    @property
    def source_files(self) -> tuple[str, ...]:
        """C sources in the order of their compilation; the headers lie beside them."""
        if self.is_plain:
            return ("fmi2.c", "integrate.c", "model.c")
        wrapper = "fmi3.c" if self.fmi_version == "3.0" else "fmi2_events.c"
        return (wrapper, "instance.c", "events.c", "integrate.c", "model.c")

    @property
    def headers(self) -> tuple[str, ...]:
        """Headers of the C sources, other than those of FMI and the generated ones."""
        return ("integrate.h",) if self.is_plain else ("instance.h", "integrate.h")


def read_settings(folder: Path) -> BuildSettings:
    """Read the build file of a model's folder.

    Args:
        folder: Folder with build.toml and the Modelica sources.

    Returns:
        The settings, checked.

    Raises:
        CompileError: If the file is missing, unreadable or wrong.
    """
    path = folder / BUILD_FILE
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        return TypeAdapter(BuildSettings).validate_python(table)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        key = ".".join(map(str, fault["loc"]))
        raise CompileError(f"{path}: {key} = {fault['input']!r}: {fault['msg']}; correct it") from None
    except (OSError, ValueError) as error:
        raise CompileError(
            f'{path}: cannot be read ({error}); it holds at least: model = "Package.Model"'
        ) from None
