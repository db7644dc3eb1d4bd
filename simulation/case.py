"""Cases: a case file read, checked against its FMU and its recordings, and ready to be opened."""

import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray, digest_of
from simulation.case_data import CaseData, on_one_axis, read_recordings
from simulation.case_file import CaseFile, InputTable, OutputTable
from simulation.case_parts import (
    check_inputs,
    conversions,
    fixed_values,
    input_values,
    with_units,
)
from simulation.case_periods import Period, measured, plain_period, time_grid, validation_period
from simulation.case_reading import read_case_file
from simulation.errors import errors_at
from simulation.fmi.description import FmuDescription, read_description
from simulation.fmi.fmu import FmuModel, FmuSettings
from simulation.fmi.variable import Value
from simulation.measurement import Measurement
from simulation.parameters import ParameterSpace
from simulation.pool.execution import ExecutionPolicy
from simulation.scenario import Scenario

_CHOSEN = ("relative_tolerance", "accepted", "parameter_factors", "parameter_offsets")
"""Settings that decide what a model answers; None is as usual."""


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
        scenario = self.scenario
        grid = {"output_every": scenario.output_every, "n_warmup": scenario.n_warmup}
        return digest_of(_json(self._named | grid), scenario.time_communication, *scenario.driving)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that decides what the model answers in its box: not of titles or estimates."""
        space, scenario = self.parameter_space, self.scenario
        steps_s = (self.communication_step_s, self.output_step_s)
        named = _json(self._named | {"window_d": self.window_d, "steps_s": steps_s})
        return digest_of(named, space.lower, space.upper, scenario.time_communication, *scenario.driving)

    @property
    def _named(self) -> dict[str, Any]:
        """What decides answers and has a name; what the case leaves as usual is left out."""
        chosen = {name: getattr(self.settings, name) for name in _CHOSEN}
        chosen |= {"watched": list(self.watched) or None, "said_units": dict(self.said_units) or None}
        return {
            "fmu": self.fmu.sha256,
            "interface": self.interface,
            "parameters": list(self.parameter_space.names),
            "fixed": sorted(self.fixed.items()),
            "inputs": list(self.scenario.input_names),
            "outputs": [(output.name, output.unit) for output in self.outputs],
        } | {name: value for name, value in chosen.items() if value is not None}

    @property
    def make_model(self) -> Callable[[], FmuModel]:
        """A picklable factory of the model, to hand to worker processes."""
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
    file = read_case_file(path)
    fmu = read_description(Path(os.path.realpath(path.parent / file.fmu)))
    fmu.interface(file.interface, str(path))
    recordings = read_recordings(path, file)
    with errors_at(path):
        fmu = with_units(fmu, _said_units(file))
        data = on_one_axis(file, recordings)
        plain = plain_period(file, window_d)
        stepped = file
        if communication_step_s is not None:
            step = {"communication_step_s": communication_step_s}
            stepped = file.model_copy(update={"time": file.time.model_copy(update=step)})
        case = _compared_over(path, stepped, fmu, data, plain)
        later = validation_period(file, plain, may_be_left_out=window_d is not None)
        if later is not None:
            case = replace(case, validation=_compared_over(path, stepped, fmu, data, later))
    return case


def _said_units(file: CaseFile) -> dict[str, str]:
    tables: list[InputTable | OutputTable] = [*file.inputs, *file.outputs]
    return {one.name: one.fmu_unit for one in tables if one.fmu_unit is not None}


def _compared_over(path: Path, file: CaseFile, fmu: FmuDescription, data: CaseData, period: Period) -> Case:
    """Build the case whose measurement is that of a period."""
    space = ParameterSpace(tuple(table.to_parameter() for table in file.parameters))
    parameters = conversions(fmu, "parameter", file.parameters)
    inputs = conversions(fmu, "input", file.inputs)
    check_inputs(file, fmu)
    outputs = [change.inverse for change in conversions(fmu, "output", file.outputs)]
    edges, output_every, n_warmup = time_grid(file, data, period)
    over_steps, at_edges = input_values(file, fmu, data, inputs, edges)
    scenario = Scenario(
        time_communication=edges,
        inputs=over_steps,
        inputs_at_edges=at_edges,
        input_names=tuple(table.name for table in file.inputs),
        output_every=output_every,
        n_warmup=n_warmup,
    )
    measurement = measured(file, data, scenario.time, period)
    bands = [table.accepted or (-np.inf, np.inf) for table in file.outputs]
    settings = FmuSettings(
        path=fmu.path,
        parameter_space=space,
        scenario=scenario,
        output_names=measurement.output_names,
        output_offsets=np.array([one.offset for one in outputs]),
        fixed=fixed_values(file, fmu, data, float(edges[0])),
        interface=file.interface,
        relative_tolerance=file.relative_tolerance,
        accepted=np.array(bands) if any(table.accepted for table in file.outputs) else None,
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
        policy=ExecutionPolicy(**file.simulation.model_dump()),
        said_units=_said_units(file),
        references=tuple(
            KnownError(table.label, table.mse, table.target)
            for table in file.references
            if table.window == period.compared_d
        ),
    )


def _unless(usual: float, values: list[float]) -> FloatArray | None:
    """Return the values as an array, None where all are as usual."""
    return None if all(value == usual for value in values) else np.array(values)


def _json(content: dict[str, Any]) -> str:
    return json.dumps(content, sort_keys=True, default=np.ndarray.tolist)
