"""Cases: a case file read, checked against its FMU and its recordings, and ready to be opened."""

import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from simulation.case_file import read_case_file
from simulation.case_parts import (
    check_inputs,
    fixed_values,
    input_values,
    measured,
    output_offset,
    parameter_space,
    read_recordings,
    time_grid,
)
from simulation.execution import ExecutionPolicy
from simulation.fmu import FmuModel, FmuSettings
from simulation.fmu_description import FmuDescription, read_description
from simulation.measurement import Measurement
from simulation.parameters import ParameterSpace
from simulation.scenario import Scenario


@dataclass(frozen=True)
class Output:
    """An output that is compared with a measurement.

    Attributes:
        name: The FMU's variable.
        unit: Unit of the measurement and of every trajectory.
        uncertainty: Uncertainty of the sensor. [unit]
        path: File of the recording.
        column: Column of the recording.
    """

    name: str
    unit: str
    uncertainty: float
    path: Path
    column: str


@dataclass(frozen=True)
class KnownError:
    """A mean squared error that is known for the case's window.

    Attributes:
        label: What reached it.
        mse: The error. [first output's unit squared]
        is_target: Whether results should say how many calls they needed to reach it.
    """

    label: str
    mse: float
    is_target: bool


@dataclass(frozen=True, eq=False)
class Case:
    """The physics of a study: which model, which parameters, driven by what, compared with what.

    Attributes:
        name: Short name, used in folders and labels.
        title: Title for reports.
        note: What must be said wherever the numbers appear, "" for nothing.
        path: The case file.
        fmu: What the FMU says about itself.
        interface: How the FMU is run.
        parameter_space: Parameters to calibrate.
        scenario: Inputs from the start of the simulation to the end of the window.
        measurement: Measured outputs over the window.
        outputs: The outputs.
        window_d: Compared part, since the recording's first row. [d]
        communication_step_s: Step over which inputs are constant. [s]
        output_step_s: Step of outputs and measurement. [s]
        settings: How the model is opened; plain data for worker processes.
        relative_tolerance: Tolerance of the solver, None for the FMU's own. [1]
        policy: How patiently simulations are run.
        references: Errors known for this window; they decide nothing.
    """

    name: str
    title: str
    note: str
    path: Path
    fmu: FmuDescription
    interface: str
    parameter_space: ParameterSpace
    scenario: Scenario
    measurement: Measurement
    outputs: tuple[Output, ...]
    window_d: tuple[float, float]
    communication_step_s: float
    output_step_s: float
    settings: FmuSettings
    relative_tolerance: float | None = None
    policy: ExecutionPolicy = field(default_factory=ExecutionPolicy)
    references: tuple[KnownError, ...] = ()

    @property
    def fmu_path(self) -> Path:
        """The FMU's file."""
        return self.fmu.path

    @property
    def fmu_sha256(self) -> str:
        """SHA-256 of the FMU's bytes, in hexadecimal."""
        return self.fmu.sha256

    @property
    def fixed(self) -> Mapping[str, float]:
        """FMU parameters held at a value. [FMU's units]."""
        return self.settings.fixed

    @cached_property
    def model_digest(self) -> str:
        """SHA-256 of all that decides what the model answers to a row: not of bounds, measurement or titles.

        What was simulated under one model digest holds for every case that has the same.
        """
        settings = self.settings
        content = hashlib.sha256(
            _json(
                {
                    "fmu": self.fmu_sha256,
                    "interface": self.interface,
                    "parameters": list(self.parameter_space.names),
                    "fixed": sorted(self.fixed.items()),
                    "inputs": list(self.scenario.input_names),
                    "outputs": [(output.name, output.unit) for output in self.outputs],
                    "output_every": self.scenario.output_every,
                    "n_warmup": self.scenario.n_warmup,
                }
                | self._choices
            )
        )
        for array in (self.scenario.time_communication, self.scenario.inputs, settings.output_offsets):
            content.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return content.hexdigest()

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that decides what the model answers in its box: not of titles or estimates."""
        space = self.parameter_space
        content = hashlib.sha256(
            _json(
                {
                    "fmu": self.fmu_sha256,
                    "interface": self.interface,
                    "parameters": list(space.names),
                    "fixed": sorted(self.fixed.items()),
                    "inputs": list(self.scenario.input_names),
                    "outputs": [(output.name, output.unit) for output in self.outputs],
                    "window_d": self.window_d,
                    "steps_s": (self.communication_step_s, self.output_step_s),
                }
                | self._choices
            )
        )
        for array in (space.lower, space.upper, self.scenario.time_communication, self.scenario.inputs):
            content.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return content.hexdigest()

    @property
    def _choices(self) -> dict[str, Any]:
        """What a case may choose beyond the usual and what then decides answers; empty for the usual."""
        chosen = {"relative_tolerance": self.relative_tolerance}
        return {name: value for name, value in chosen.items() if value is not None}

    @property
    def make_model(self) -> Callable[[], FmuModel]:
        """A picklable recipe for the model, to hand to worker processes."""
        return self.settings.open

    def open_model(self) -> FmuModel:
        """Open the model in this process.

        Returns:
            The model; close it, or use it in a `with` block.
        """
        return self.make_model()


def load_case(
    path: Path | str,
    window_d: tuple[float, float] | None = None,
    communication_step_s: float | None = None,
) -> Case:
    """Read a case and check everything about it that can be checked without simulating.

    Args:
        path: The case file, or the folder that holds it as case.toml.
        window_d: Window to use instead of the file's. [d]
        communication_step_s: Step to use instead of the file's, to see what it does. [s]

    Returns:
        The case.

    Raises:
        InputError: If anything in the file, the FMU or the recordings is missing, wrong or contradictory.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "case.toml"
    file = read_case_file(path)
    if communication_step_s is not None:
        step = {"communication_step_s": communication_step_s}
        file = file.model_copy(update={"time": file.time.model_copy(update=step)})
    fmu = read_description((path.parent / file.fmu).resolve())
    space = parameter_space(path, file, fmu)
    check_inputs(path, file, fmu)
    recordings = read_recordings(path, file)
    window = window_d if window_d is not None else file.time.window_d
    edges, output_every, n_warmup = time_grid(path, file, recordings, window)
    scenario = Scenario(
        time_communication=edges,
        inputs=input_values(path, file, fmu, recordings, edges),
        input_names=tuple(table.name for table in file.inputs),
        output_every=output_every,
        n_warmup=n_warmup,
    )
    measurement = measured(path, file, recordings, scenario.time)
    at_start = measured(path, file, recordings, scenario.time_simulated[:1])
    settings = FmuSettings(
        path=fmu.path,
        parameter_space=space,
        scenario=scenario,
        output_names=measurement.output_names,
        output_offsets=-np.array([output_offset(path, table, fmu) for table in file.outputs]),
        fixed=fixed_values(path, file, fmu, at_start),
    )
    return Case(
        name=file.name,
        title=file.title or file.name,
        note=file.note,
        path=path,
        fmu=fmu,
        interface=file.interface,
        parameter_space=space,
        scenario=scenario,
        measurement=measurement,
        outputs=tuple(
            Output(table.name, table.unit, table.uncertainty, recordings[table.file].path, table.column)
            for table in file.outputs
        ),
        window_d=(float(window[0]), float(window[1])),
        communication_step_s=file.time.communication_step_s,
        output_step_s=file.time.output_step_s,
        settings=settings,
        relative_tolerance=file.relative_tolerance,
        policy=ExecutionPolicy(**file.simulation.model_dump()),
        references=tuple(
            KnownError(table.label, table.mse, table.target)
            for table in file.references
            if table.window_d == tuple(window)
        ),
    )


def _json(content: dict[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True).encode()
