"""Cases: a case file read, checked against its FMU and its recordings, and ready to be opened."""

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case_data import CaseData, read_data
from simulation.case_file import CaseFile
from simulation.case_parts import (
    Value,
    accepted_bands,
    check_inputs,
    fixed_values,
    input_values,
    output_conversions,
    parameter_conversions,
    parameter_space,
)
from simulation.case_periods import Period, measured, plain_period, time_grid, validation_period
from simulation.case_reading import read_case_file
from simulation.case_units import said_units, with_units
from simulation.fmi.description import FmuDescription, read_description
from simulation.fmi.fmu import FmuModel, FmuSettings
from simulation.measurement import Measurement
from simulation.parameters import ParameterSpace
from simulation.pool.execution import ExecutionPolicy
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
        parameter_space: Parameters to calibrate, in the units of the case file.
        scenario: Inputs from the start of the simulation to the end of the reported part.
        measurement: Measured outputs over the window.
        outputs: The outputs.
        window_d: Compared part, in days of the case file. [d]
        communication_step_s: Step over which inputs are constant. [s]
        output_step_s: Step of the outputs. [s]
        settings: How the model is opened; plain data for worker processes.
        policy: How patiently simulations are run.
        said_units: Units of variables that the FMU declares none for, by name.
        references: Errors known for this window; they decide nothing.
        watched: Variables of the FMU that it answers beside the outputs, after them.
        validation: The same model compared over the validation period instead, None without one. Its
            simulations start as the case's do and go on; nothing of it decides what is calibrated.
    """

    name: str
    title: str
    note: str
    path: Path
    fmu: FmuDescription
    parameter_space: ParameterSpace
    scenario: Scenario
    measurement: Measurement
    outputs: tuple[Output, ...]
    window_d: tuple[float, float]
    communication_step_s: float
    output_step_s: float
    settings: FmuSettings
    policy: ExecutionPolicy = field(default_factory=ExecutionPolicy)
    said_units: Mapping[str, str] = field(default_factory=dict)
    references: tuple[KnownError, ...] = ()
    watched: tuple[str, ...] = ()
    validation: "Case | None" = None

    @property
    def fmu_path(self) -> Path:
        """The FMU's file."""
        return self.fmu.path

    @property
    def fmu_sha256(self) -> str:
        """SHA-256 of the FMU's bytes, in hexadecimal."""
        return self.fmu.sha256

    @property
    def interface(self) -> str:
        """How the FMU is run."""
        return self.settings.interface

    @property
    def fixed(self) -> Mapping[str, Value]:
        """FMU parameters held at a value. [FMU's units]."""
        return self.settings.fixed

    @cached_property
    def model_digest(self) -> str:
        """SHA-256 of all that decides what the model answers to a row: not of bounds, measurement or titles.

        What was simulated under one model digest holds for every case that has the same.
        """
        content = hashlib.sha256(
            _json(
                self._named | {"output_every": self.scenario.output_every, "n_warmup": self.scenario.n_warmup}
            )
        )
        for array in (self.scenario.time_communication, self.scenario.inputs):
            content.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return content.hexdigest()

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that decides what the model answers in its box: not of titles or estimates."""
        space = self.parameter_space
        steps_s = (self.communication_step_s, self.output_step_s)
        content = hashlib.sha256(_json(self._named | {"window_d": self.window_d, "steps_s": steps_s}))
        for array in (space.lower, space.upper, self.scenario.time_communication, self.scenario.inputs):
            content.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
        return content.hexdigest()

    @property
    def _named(self) -> dict[str, Any]:
        """What decides answers and has a name; what the case leaves as usual is left out."""
        settings = self.settings
        chosen = {
            "relative_tolerance": settings.relative_tolerance,
            "accepted": settings.accepted,
            "warmup_theta": settings.warmup_theta if settings.shared_warmup else None,
            "parameter_factors": settings.parameter_factors,
            "parameter_offsets": settings.parameter_offsets,
            "watched": list(self.watched) or None,
            "said_units": dict(self.said_units) or None,
        }
        return {
            "fmu": self.fmu_sha256,
            "interface": settings.interface,
            "parameters": list(self.parameter_space.names),
            "fixed": sorted(self.fixed.items()),
            "inputs": list(self.scenario.input_names),
            "outputs": [(output.name, output.unit) for output in self.outputs],
        } | {
            name: value.tolist() if isinstance(value, np.ndarray) else value
            for name, value in chosen.items()
            if value is not None
        }

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
        window_d: Window to use instead of the file's; the validation period is left out where it overlaps or
            begins before it. [d]
        communication_step_s: Step to use instead of the file's, to see what it does. [s]

    Returns:
        The case.

    Raises:
        InputError: If anything in the file, the FMU or the recordings is missing, wrong or contradictory.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "case.toml"
    file = declared = read_case_file(path)
    if communication_step_s is not None:
        step = {"communication_step_s": communication_step_s}
        file = file.model_copy(update={"time": file.time.model_copy(update=step)})
    fmu = with_units(read_description(Path(os.path.realpath(path.parent / file.fmu))), said_units(file), path)
    fmu.interface(file.interface, str(path))
    data = read_data(path, file)
    window = file.time.window if window_d is None else window_d
    plain = plain_period(path, declared, window, is_overridden=window_d is not None)
    case = _compared_over(path, file, fmu, data, plain)
    period = validation_period(path, declared, window, is_overridden=window_d is not None)
    if period is None:
        return case
    return replace(case, validation=_compared_over(path, file, fmu, data, period))


def _compared_over(path: Path, file: CaseFile, fmu: FmuDescription, data: CaseData, period: Period) -> Case:
    """Build the case whose measurement is that of a period."""
    space = parameter_space(path, file)
    parameters = parameter_conversions(path, file, fmu)
    check_inputs(path, file, fmu)
    outputs = output_conversions(path, file, fmu)
    edges, output_every, n_warmup = time_grid(path, file, data, period)
    scenario = Scenario(
        time_communication=edges,
        inputs=input_values(path, file, fmu, data, edges),
        input_names=tuple(table.name for table in file.inputs),
        output_every=output_every,
        n_warmup=n_warmup,
    )
    accepted = accepted_bands(path, file.outputs)
    measurement = measured(file, data, scenario.time, period)
    settings = FmuSettings(
        path=fmu.path,
        parameter_space=space,
        scenario=scenario,
        output_names=measurement.output_names,
        output_offsets=np.array([one.offset for one in outputs]),
        fixed=fixed_values(path, file, fmu, data, float(edges[0])),
        interface=file.interface,
        relative_tolerance=file.relative_tolerance,
        accepted=accepted,
        shared_warmup=file.time.shared_warmup,
        warmup_theta=space.expected if file.time.shared_warmup else None,
        output_factors=_unless(1.0, [one.factor for one in outputs]),
        parameter_factors=_unless(1.0, [one.factor for one in parameters]),
        parameter_offsets=_unless(0.0, [one.offset for one in parameters]),
    )
    return Case(
        name=file.name,
        title=file.title or file.name,
        note=file.note,
        path=path,
        fmu=fmu,
        parameter_space=space,
        scenario=scenario,
        measurement=measurement,
        outputs=tuple(
            Output(table.name, table.unit, table.uncertainty, data.recordings[table.file].path, table.column)
            for table in file.outputs
        ),
        window_d=period.compared_d,
        communication_step_s=file.time.communication_step_s,
        output_step_s=file.time.output_step_s,
        settings=settings,
        policy=ExecutionPolicy(**file.simulation.model_dump(), opening_s=file.simulation.timeout_s),
        said_units=said_units(file),
        references=tuple(
            KnownError(table.label, table.mse, table.target)
            for table in file.references
            if table.window == period.compared_d
        ),
    )


def _unless(usual: float, values: list[float]) -> FloatArray | None:
    """Return the values as an array, None where all are as usual."""
    return None if all(value == usual for value in values) else np.array(values)


def _json(content: dict[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True).encode()
