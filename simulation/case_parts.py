"""From the tables of a case file to its checked parts; every contradiction is found here."""

import math
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.case_file import CaseFile, FirstMeasured, OutputTable, ValueWithUnit
from simulation.errors import InputError
from simulation.fmu_description import FmuDescription
from simulation.measurement import Measurement
from simulation.parameters import Parameter, ParameterSpace
from simulation.recording import Recording, read_recording
from simulation.scenario import covers, values_over_steps
from simulation.units import offset_between, same_unit

DAY_S = 86400.0


def parameter_space(path: Path, file: CaseFile, fmu: FmuDescription) -> ParameterSpace:
    """Check the parameters against the FMU and return their box."""
    for table in file.parameters:
        where = f"{path}: parameters[{table.name}]"
        variable = fmu.require(table.name, "parameter", where)
        if not same_unit(table.unit, variable.unit):
            raise InputError(
                f'{where}: unit = "{table.unit}" contradicts the FMU\'s "{variable.unit}"; '
                f'give bounds and estimate in "{variable.unit}"'
            )
    try:
        return ParameterSpace(tuple(Parameter(**table.model_dump()) for table in file.parameters))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def check_inputs(path: Path, file: CaseFile, fmu: FmuDescription) -> None:
    """Check that the case and the FMU name the same inputs, each once."""
    names = [table.name for table in file.inputs]
    for name in names:
        fmu.require(name, "input", f"{path}: inputs[{name}]")
        if names.count(name) > 1:
            raise InputError(f"{path}: inputs[{name}] is declared {names.count(name)} times; keep one")
    for name in fmu.names("input"):
        if name not in names:
            raise InputError(
                f"{path}: the FMU's input {name} has no [[inputs]] entry; add one, else it stays at its start"
            )


def read_recordings(path: Path, file: CaseFile) -> dict[str, Recording]:
    """Read every file that the case names, each once, by its name in the case."""
    columns: dict[str, list[str]] = {}
    for table in file.outputs:
        columns.setdefault(table.file, []).append(table.column)
    for source in file.inputs:
        columns.setdefault(source.file, []).extend(source.weights)
    folder = path.parent / file.data
    return {
        name: read_recording(
            Path((folder / name).resolve()), list(dict.fromkeys(wanted)), if_missing=file.data_origin
        )
        for name, wanted in columns.items()
    }


def time_grid(
    path: Path, file: CaseFile, recordings: dict[str, Recording], window_d: tuple[float, float]
) -> tuple[FloatArray, int, int]:
    """Lay out the communication steps from the start of the simulation to the end of the window.

    Returns:
        Edges of the steps [s], number of steps between two outputs, number of outputs before the window.
    """
    begin_d, end_d = window_d
    where = f"{path}: window_d = [{begin_d:g}, {end_d:g}]"
    if not (math.isfinite(begin_d) and math.isfinite(end_d) and 0.0 <= begin_d < end_d):
        raise InputError(f"{where}: the end must lie after the start and neither before day 0; correct it")
    start_d = begin_d if file.time.start_d is None else file.time.start_d
    if not 0.0 <= start_d <= begin_d:
        raise InputError(
            f"{path}: time.start_d = {start_d:g} does not lie between day 0 and the window's start, "
            f"{begin_d:g}; correct it"
        )
    step, output_step = file.time.communication_step_s, file.time.output_step_s
    if not step > 0:
        raise InputError(f"{path}: communication_step_s = {step:g} is not above 0; correct it")
    output_every = round(output_step / step)
    if output_every < 1 or not math.isclose(output_every * step, output_step, rel_tol=1e-9):
        raise InputError(
            f"{path}: time.output_step_s = {output_step:g} is no multiple of "
            f"communication_step_s = {step:g}; choose steps that fit"
        )
    n_window = _whole_steps(end_d - begin_d, output_step, where)
    n_warmup = _whole_steps(begin_d - start_d, output_step, f"{path}: time.start_d = {start_d:g}")
    recording = recordings[file.outputs[0].file]
    start = float(recording.time[0]) + start_d * DAY_S
    length_d = (recording.time[-1] - recording.time[0]) / DAY_S
    if end_d > length_d + 1e-9:
        raise InputError(
            f"{where}: the recording {recording.path} ends after {length_d:.6g} days; shorten the window"
        )
    n_steps = (n_warmup + n_window) * output_every
    return start + step * np.arange(n_steps + 1, dtype=np.float64), output_every, n_warmup


def _whole_steps(span_d: float, output_step: float, where: str) -> int:
    """Return how many output steps [s] a span [d] holds."""
    n_steps = round(span_d * DAY_S / output_step)
    if not math.isclose(n_steps * output_step, span_d * DAY_S, rel_tol=1e-9):
        raise InputError(
            f"{where}: not a whole number of output steps of {output_step:g} s; choose days that fit"
        )
    return n_steps


def input_values(
    path: Path, file: CaseFile, fmu: FmuDescription, recordings: dict[str, Recording], edges: FloatArray
) -> FloatArray:
    """Return every input over every step. Shape (m, n_inputs). [FMU's units]."""
    inputs = np.zeros((len(edges) - 1, len(file.inputs)))
    for index, table in enumerate(file.inputs):
        where, recording = f"{path}: inputs[{table.name}]", recordings[table.file]
        offset = offset_between(table.unit, fmu.variables[table.name].unit, where)
        if not covers(recording.time, edges, table.interpolation):
            raise InputError(
                f"{where}: {recording.path} covers {recording.time[0]:.12g} to {recording.time[-1]:.12g} s, "
                f"the window needs {edges[0]:.12g} to {edges[-1]:.12g} s; shorten window_d or record longer"
            )
        for column, weight in table.weights.items():
            inputs[:, index] += weight * values_over_steps(
                recording.time, recording.columns[column], edges, interpolation=table.interpolation
            )
        inputs[:, index] += offset
    return inputs


def measured(path: Path, file: CaseFile, recordings: dict[str, Recording], time: FloatArray) -> Measurement:
    """Return the measurement at the output times."""
    names = tuple(table.name for table in file.outputs)
    y = np.empty((len(time), len(names)))
    for index, table in enumerate(file.outputs):
        if names.count(table.name) > 1:
            raise InputError(
                f"{path}: outputs[{table.name}] is declared {names.count(table.name)} times; keep one"
            )
        recording = recordings[table.file]
        at = np.rint((time - recording.time[0]) / recording.step_s).astype(np.int64)
        inside = np.clip(at, 0, len(recording.time) - 1)
        off = np.abs(recording.time[inside] - time) > 1e-6 * recording.step_s
        if off.any():
            raise InputError(
                f"{path}: outputs[{table.name}]: {recording.path} has no sample at {time[off][0]:.12g} s; "
                "choose an output_step_s and a window_d that fall on the samples"
            )
        y[:, index] = recording.columns[table.column][at]
    return Measurement(time, y, names, np.array([table.uncertainty for table in file.outputs]))


def output_offset(path: Path, table: OutputTable, fmu: FmuDescription) -> float:
    """Return what turns the declared unit of an output into the FMU's."""
    where = f"{path}: outputs[{table.name}]"
    return offset_between(table.unit, fmu.require(table.name, "output", where).unit, where)


def fixed_values(path: Path, file: CaseFile, fmu: FmuDescription, at_start: Measurement) -> dict[str, float]:
    """Return the parameters held at a value. [FMU's units]."""
    values = {}
    for name, value in file.fixed.items():
        where = f"{path}: fixed.{name}"
        variable = fmu.require(name, "parameter", where)
        if any(table.name == name for table in file.parameters):
            raise InputError(f"{where}: {name} is also under [[parameters]]; drop one of the two")
        if isinstance(value, FirstMeasured):
            if value.first_measured not in at_start.output_names:
                raise InputError(
                    f'{where}: first_measured = "{value.first_measured}" is no output of the case; '
                    f"choose one of: {', '.join(at_start.output_names)}"
                )
            index = at_start.output_names.index(value.first_measured)
            offset = offset_between(file.outputs[index].unit, variable.unit, where)
            values[name] = float(at_start.y[0, index]) + offset
        elif isinstance(value, ValueWithUnit):
            values[name] = value.value + offset_between(value.unit, variable.unit, where)
        elif isinstance(value, str):
            raise InputError(f"{where} = {value!r}: {name} is a number; give one")
        else:
            values[name] = float(value)
    return values
