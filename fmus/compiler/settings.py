"""What build.toml in a model's folder says."""

import math
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path

from fmus.compiler.errors import CompileError

BUILD_FILE = "build.toml"
SOLVERS = ("exact", "rk4")
FMI_VERSIONS = ("2.0", "3.0")


@dataclass(frozen=True)
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
    solver: str = "rk4"
    name: str = ""
    fmi_version: str = "2.0"
    model_exchange_only: bool = False
    events: bool = False
    max_substep_s: float = 60.0
    tolerance: float = 1e-9
    start_time_s: float = 0.0
    stop_time_s: float = 86400.0
    step_size_s: float = 600.0

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
    except FileNotFoundError:
        raise CompileError(f'{path}: not found; write it with at least: model = "Package.Model"') from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise CompileError(f"{path}: cannot be read ({error}); correct it") from None
    known = {field.name: field.type for field in fields(BuildSettings)}
    for key, value in table.items():
        if key not in known:
            raise CompileError(f"{path}: unknown key {key!r}; known are {', '.join(known)}")
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if known[key] is str and not isinstance(value, str):
            raise CompileError(f"{path}: {key} = {value!r} must be a text")
        if known[key] is bool and not isinstance(value, bool):
            raise CompileError(f"{path}: {key} = {value!r} must be true or false")
        if known[key] is float and not (is_number and math.isfinite(value)):
            raise CompileError(f"{path}: {key} = {value!r} must be a finite number")
    if "model" not in table:
        raise CompileError(f'{path}: the key model is missing; name the class, as in "Package.Model"')
    settings = BuildSettings(**table)
    if settings.solver not in SOLVERS:
        raise CompileError(f"{path}: solver = {settings.solver!r} is unknown; known are {', '.join(SOLVERS)}")
    if settings.fmi_version not in FMI_VERSIONS:
        raise CompileError(
            f"{path}: fmi_version = {settings.fmi_version!r} is unknown; known are {', '.join(FMI_VERSIONS)}"
        )
    for key in ("max_substep_s", "tolerance", "step_size_s"):
        if getattr(settings, key) <= 0:
            raise CompileError(f"{path}: {key} = {getattr(settings, key)} must be positive")
    if settings.stop_time_s <= settings.start_time_s:
        raise CompileError(f"{path}: stop_time_s = {settings.stop_time_s} must exceed start_time_s")
    if not (settings.identifier.isascii() and settings.identifier.isidentifier()):
        raise CompileError(f"{path}: name = {settings.identifier!r} must be letters, digits and underscores")
    return settings
