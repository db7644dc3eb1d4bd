"""FmuModel: an FMI 2.0 co-simulation FMU as a forward model; the only module that runs an FMU."""

import contextlib
import ctypes
import os
import weakref
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
from fmpy import fmi2

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.fmu_description import FmuDescription, read_description
from simulation.fmu_loop import FUNCTIONS, WARNING, simulate_row
from simulation.fmu_unpack import UnpackedFmu
from simulation.parameters import ParameterSpace
from simulation.scenario import Scenario
from simulation.trajectories import Trajectories

_STATUS: Final = ("fmi2OK", "fmi2Warning", "fmi2Discard", "fmi2Error", "fmi2Fatal", "fmi2Pending")
_FATAL: Final = 4


@dataclass(frozen=True, eq=False)
class FmuSettings:
    """Everything needed to open an FMU as a forward model; plain data that travels to worker processes.

    Attributes:
        path: The FMU.
        parameter_space: The parameters, by the FMU's names and in the declared units.
        scenario: Inputs and times.
        output_names: The FMU's output variables.
        output_offsets: Added to the FMU's outputs, for instance -273.15 from K to degC. Shape (k,).
        output_factors: The FMU's outputs are multiplied by it before; None for 1 throughout. Shape (k,).
        parameter_factors: From a parameter's declared unit to the FMU's; None for 1 throughout. Shape (p,).
        parameter_offsets: Added after that; None for 0 throughout. Shape (p,). [FMU's units]
        fixed: FMU parameters held at a value, in the FMU's units.
    """

    path: Path
    parameter_space: ParameterSpace
    scenario: Scenario
    output_names: tuple[str, ...]
    output_offsets: FloatArray
    fixed: Mapping[str, float] = field(default_factory=dict)
    output_factors: FloatArray | None = None
    parameter_factors: FloatArray | None = None
    parameter_offsets: FloatArray | None = None

    def __post_init__(self) -> None:
        both = [name for name in self.fixed if name in self.parameter_space.names]
        if both:
            raise InputError(f"{self.path}: {both[0]} is both fixed and calibrated; drop one of the two")

    def parameters_for_fmu(self, theta: FloatArray) -> FloatArray:
        """Convert parameters to the FMU's units. Shape (n, p) or (p,)."""
        if self.parameter_factors is not None:
            theta = theta * self.parameter_factors
        return theta if self.parameter_offsets is None else theta + self.parameter_offsets

    def outputs_from_fmu(self, y: FloatArray) -> None:
        """Convert outputs to the declared units, in place. Shape (..., k)."""
        if self.output_factors is not None:
            y *= self.output_factors
        y += self.output_offsets

    def open(self) -> "FmuModel":
        """Open the model; the bound method is the picklable recipe that worker processes are given."""
        return FmuModel(self)


class FmuModel:
    """A co-simulation FMU that answers parameter rows.

    One instance lives as long as the model and is reset between rows (a fresh one costs tens of times as
    much, and processes die after about a thousand). Not for use from several threads at once.
    """

    def __init__(self, settings: FmuSettings) -> None:
        """Unpack, load and instantiate the FMU.

        Args:
            settings: What to open, and how to drive it.

        Raises:
            InputError: If the FMU cannot be opened or does not have the variables.
        """
        self._settings = settings
        description = read_description(settings.path)
        space, scenario = settings.parameter_space, settings.scenario
        self._parameter_references = _references(description, [*settings.fixed, *space.names], "parameter")
        self._input_references = _references(description, scenario.input_names, "input")
        self._output_references = _references(description, settings.output_names, "output")
        self._fixed = np.array(list(settings.fixed.values()), dtype=np.float64)
        self._inputs = np.ascontiguousarray(scenario.inputs, dtype=np.float64)
        self._edges = np.ascontiguousarray(scenario.time_communication, dtype=np.float64)
        unpacked = UnpackedFmu(settings.path)
        try:
            self._instance = _Instance(description, unpacked.folder)
        except BaseException:
            unpacked.remove()
            raise
        # The finalizer runs at close(), when the model is forgotten, or when the interpreter ends.
        self._finalizer = weakref.finalize(self, _close, self._instance, unpacked)

    @property
    def parameter_space(self) -> ParameterSpace:
        """The parameters to calibrate."""
        return self._settings.parameter_space

    @property
    def output_names(self) -> tuple[str, ...]:
        """The outputs."""
        return self._settings.output_names

    @property
    def time(self) -> FloatArray:
        """Output times. Shape (t,). [s]."""
        return self._settings.scenario.time

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row; one that is NaN, is refused by the FMU or ends in NaN fails with the reason.

        Args:
            theta: Parameters. Shape (n, p). [model's units]

        Returns:
            The trajectories. y of shape (n, t, k). [declared output units]
        """
        if not self._finalizer.alive:
            raise ValueError("the model is closed; open it again")
        theta = np.asarray(theta, dtype=np.float64)
        if theta.ndim != 2 or theta.shape[1] != self.parameter_space.n_parameters:
            raise ValueError(
                f"theta has shape {theta.shape}; expected (n, {self.parameter_space.n_parameters})"
            )
        scenario = self._settings.scenario
        y = np.full((len(theta), len(scenario.time_simulated), len(self.output_names)), np.nan)
        # A NaN parameter raises nothing in most FMUs, so such a row is never handed over.
        failures = [
            self._simulate_row(row, y[i]) if np.isfinite(row).all() else "" for i, row in enumerate(theta)
        ]
        self._settings.outputs_from_fmu(y)
        return Trajectories.checked(
            theta,
            y[:, scenario.n_warmup :],
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
            failures=failures,
        )

    def _simulate_row(self, row: FloatArray, y: FloatArray) -> str:
        """Fill y with one row's outputs; return why it failed, "" when it did not."""
        _MESSAGES.clear()
        status, stage, step = simulate_row(
            self._instance.functions,
            self._instance.component,
            self._parameter_references,
            np.concatenate([self._fixed, self._settings.parameters_for_fmu(row)]),
            self._input_references,
            self._inputs,
            self._output_references,
            self._edges,
            self._settings.scenario.output_every,
            y,
        )
        if status <= WARNING:
            return ""
        said = f": {_MESSAGES[-1]}" if _MESSAGES else ""
        name = _STATUS[status] if status < len(_STATUS) else f"status {status}"
        self._instance.recover(fatal=status >= _FATAL)
        return f"{FUNCTIONS[stage]} returned {name} at {self._edges[step]:g} s{said}"

    def close(self) -> None:
        """Free the instance and remove the unpacked folder; closing twice does no harm."""
        self._finalizer()

    def __enter__(self) -> "FmuModel":
        """Return the open model."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the model."""
        self.close()


class _Instance:
    """One FMU instance through fmpy's loader, and the addresses of its functions."""

    def __init__(self, description: FmuDescription, folder: Path) -> None:
        self._path = description.path
        # Loading changes the working directory, and fmpy leaves it changed when loading fails.
        before = Path.cwd()
        try:
            self._slave: Any = fmi2.FMU2Slave(
                guid=description.guid,
                modelIdentifier=description.model_identifier,
                unzipDirectory=str(folder),
            )
            library = self._slave.dll
            addresses = [ctypes.cast(getattr(library, name), ctypes.c_void_p).value for name in FUNCTIONS]
        except Exception as error:
            raise InputError(f"{self._path}: cannot be loaded ({' '.join(str(error).split())})") from None
        finally:
            os.chdir(before)
        self.functions = np.array(addresses, dtype=np.intp)
        self._fresh()

    def _fresh(self) -> None:
        _MESSAGES.clear()
        try:
            self._slave.instantiate(callbacks=_CALLBACKS)
        except Exception:
            said = f" ({_MESSAGES[-1]})" if _MESSAGES else ""
            raise InputError(
                f"{self._path}: the FMU refuses to be instantiated{said}; try it in another FMI tool"
            ) from None
        self.component = int(getattr(self._slave.component, "value", self._slave.component))

    def recover(self, *, fatal: bool) -> None:
        """Replace the instance after a failed row: not every FMU can be reset out of an error."""
        # After fmi2Fatal the standard allows no call at all, not even to free the instance.
        if not fatal:
            self._slave.fmi2FreeInstance(self._slave.component)
        self._fresh()

    def free(self) -> None:
        """Free the instance and unload the library."""
        with contextlib.suppress(Exception):
            self._slave.freeInstance()


def _close(instance: _Instance, unpacked: UnpackedFmu) -> None:
    instance.free()
    unpacked.remove()


def _references(description: FmuDescription, names: Any, causality: str) -> Any:
    where = str(description.path)
    return np.array(
        [description.require(name, causality, where).reference for name in names], dtype=np.uint32
    )


# The last message of any FMU of this process; one logger serves all, as fmpy's proxy can hold only one.
_MESSAGES: deque[str] = deque(maxlen=1)


def _remember(_environment: object, _name: object, status: int, _category: object, message: bytes) -> None:
    if status > WARNING and message:
        _MESSAGES.append(" ".join(message.decode("utf-8", "replace").split()))


def _callbacks() -> Any:
    callbacks: Any = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(_remember)
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    # The proxy fills in the message's printf arguments; where there is none, they stay raw.
    with contextlib.suppress(Exception):
        from fmpy.logging import addLoggerProxy

        addLoggerProxy(ctypes.byref(callbacks))
    return callbacks


_CALLBACKS: Final = _callbacks()
