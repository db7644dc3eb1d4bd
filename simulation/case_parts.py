"""From the tables of a case file to parts that agree with the FMU; every contradiction is found here."""

from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.case_data import CaseData
from simulation.case_file import CaseFile, FirstMeasured, FixedValue, OutputTable, ValueWithUnit
from simulation.errors import InputError
from simulation.fmi.description import FmuDescription
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.foreign_text import shortened
from simulation.parameters import ParameterSpace
from simulation.scenario import values_over_steps
from simulation.units import Conversion, conversion

Value = float | int | bool | str


def parameter_space(path: Path, file: CaseFile) -> ParameterSpace:
    """Return the box of the parameters, in the units of the case file."""
    try:
        return ParameterSpace(tuple(table.to_parameter() for table in file.parameters))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def parameter_conversions(path: Path, file: CaseFile, fmu: FmuDescription) -> list[Conversion]:
    """Check the parameters against the FMU and return how each gets into the FMU's unit."""
    found = []
    for table in file.parameters:
        where = f"{path}: parameters[{table.name}]"
        variable = fmu.require(table.name, "parameter", where, may_be_input=True)
        found.append(into(fmu, variable, table.unit, where))
    return found


def output_conversions(path: Path, file: CaseFile, fmu: FmuDescription) -> list[Conversion]:
    """Check the outputs against the FMU and return how each gets from its unit into the declared one."""
    found = []
    for table in file.outputs:
        where = f"{path}: outputs[{table.name}]"
        found.append(into(fmu, fmu.require(table.name, "output", where), table.unit, where).inverse)
    return found


def into(fmu: FmuDescription, variable: FmuVariable, unit: str, where: str) -> Conversion:
    """Return the conversion from a declared unit into that of a variable."""
    return conversion(unit, variable.unit, where, definitions=fmu.units, is_difference=variable.is_difference)


def check_inputs(path: Path, file: CaseFile, fmu: FmuDescription) -> None:
    """Check that every input of the FMU has one source: a recording, a value, or that it is calibrated."""
    names, calibrated = [table.name for table in file.inputs], [table.name for table in file.parameters]
    for name in names:
        fmu.require(name, "input", f"{path}: inputs[{name}]")
        if names.count(name) > 1:
            raise InputError(f"{path}: inputs[{name}] is declared {names.count(name)} times; keep one")
        if name in file.fixed:
            raise InputError(f"{path}: inputs[{name}] is also under [fixed]; drop one of the two")
        if name in calibrated:
            raise InputError(f"{path}: inputs[{name}] is also under [[parameters]]; drop one of the two")
    for name in fmu.names("input"):
        # What nothing can set must not stand in the way of the others; the doctor tells of it.
        has_source = name in names or name in file.fixed or name in calibrated
        if not has_source and not fmu.variables[name].is_out_of_reach:
            raise InputError(
                f"{path}: the FMU's input {name} has no [[inputs]] entry; add one, else it stays at its "
                "start; or hold it at a value under [fixed], or calibrate it under [[parameters]]"
            )


def input_values(
    path: Path, file: CaseFile, fmu: FmuDescription, data: CaseData, edges: FloatArray
) -> FloatArray:
    """Return every input over every step. Shape (m, n_inputs). [FMU's units]."""
    inputs = np.zeros((len(edges) - 1, len(file.inputs)))
    for index, table in enumerate(file.inputs):
        where = f"{path}: inputs[{table.name}]"
        variable = fmu.variables[table.name]
        change = into(fmu, variable, table.unit, where)
        if variable.kind not in REAL_KINDS and table.interpolation != "held":
            raise InputError(
                f'{where}: interpolation = "{table.interpolation}", but the FMU\'s {table.name} is of type '
                f'{variable.kind} and knows nothing in between; write interpolation = "held"'
            )
        for column, weight in table.weights.items():
            time, values = data.input_series(table, column, edges, where)
            inputs[:, index] += weight * values_over_steps(
                time, values, edges, interpolation=table.interpolation
            )
        if change.factor != 1.0:
            inputs[:, index] *= change.factor
        inputs[:, index] += change.offset
        if variable.kind not in REAL_KINDS:
            _check_whole(variable, inputs[:, index], edges, f"{where}: {' + '.join(table.weights)}")
    return inputs


def _check_whole(variable: FmuVariable, values: FloatArray, edges: FloatArray, where: str) -> None:
    """Check the values of an input that is no real number: whole, and known to its type."""
    words, known = "whole numbers", values == np.rint(values)
    if variable.kind == "Boolean":
        words, known = "0 or 1", np.isin(values, (0.0, 1.0))
    elif variable.items:
        words = "one of: " + ", ".join(f"{number} ({item})" for item, number in variable.items.items())
        known = np.isin(values, list(variable.items.values()))
    for step in np.flatnonzero(~known)[:1]:
        raise InputError(
            f"{where} is {values[step]:g} at {edges[step]:.12g} s, and the FMU's {variable.name} is of type "
            f"{variable.kind}; give {words}"
        )


def fixed_values(
    path: Path, file: CaseFile, fmu: FmuDescription, data: CaseData, start_s: float
) -> dict[str, Value]:
    """Return the parameters held at a value. [FMU's units].

    Args:
        path: The case file.
        file: Its content.
        fmu: What the FMU says of itself.
        data: The recordings, for first measured values.
        start_s: Start of the simulation. [s]
    """
    values = {}
    for name, value in file.fixed.items():
        where = f"{path}: fixed.{name}"
        variable = fmu.find(name, "parameter", where, may_be_input=True)
        if any(table.name == name for table in file.parameters):
            raise InputError(f"{where}: {name} is also under [[parameters]]; drop one of the two")
        values[name] = (
            _real(file, fmu, variable, value, data, start_s, where)
            if variable.kind in REAL_KINDS
            else _not_real(variable, value, where)
        )
    return values


def _real(
    file: CaseFile,
    fmu: FmuDescription,
    variable: FmuVariable,
    value: FixedValue,
    data: CaseData,
    start_s: float,
    where: str,
) -> float:
    if isinstance(value, FirstMeasured):
        names = [table.name for table in file.outputs]
        if value.first_measured not in names:
            raise InputError(
                f'{where}: first_measured = "{value.first_measured}" is no output of the case; '
                f"choose one of: {shortened(', '.join(names), 1000)}"
            )
        table = file.outputs[names.index(value.first_measured)]
        change, number = into(fmu, variable, table.unit, where), data.first_measured(table, start_s, where)
    elif isinstance(value, ValueWithUnit):
        change, number = into(fmu, variable, value.unit, where), value.value
    elif isinstance(value, bool | str):
        raise InputError(f"{where} = {_as_toml(value)}: {variable.name} is a number; give one")
    else:
        return float(value)
    return number * change.factor + change.offset


def _not_real(variable: FmuVariable, value: FixedValue, where: str) -> Value:
    """Check a value against the kind of its variable, which is not a real number."""
    kind = variable.kind
    if isinstance(value, FirstMeasured | ValueWithUnit):
        raise InputError(
            f"{where}: {variable.name} is of type {kind}, which has no unit; give the value alone"
        )
    if kind == "Enumeration" and isinstance(value, str):
        if value not in variable.items:
            raise InputError(
                f'{where} = "{value}": {variable.name} has no such item; choose one of: '
                f"{shortened(', '.join(variable.items), 1000) or 'its numbers'}"
            )
        return variable.items[value]
    wanted = {"Boolean": ("true or false", bool), "String": ('a text in "quotes"', str)}
    words, python_type = wanted.get(kind, ("a whole number", int))
    if not isinstance(value, python_type) or (python_type is int and isinstance(value, bool)):
        raise InputError(f"{where} = {_as_toml(value)}: {variable.name} is of type {kind}; give {words}")
    if variable.items and value not in variable.items.values():
        raise InputError(
            f"{where} = {value}: {variable.name} has no such item; choose one of: "
            f"{shortened(', '.join(variable.items), 1000)}"
        )
    return value


def _as_toml(value: Value) -> str:
    return str(value).lower() if isinstance(value, bool) else repr(value)


def accepted_bands(path: Path, outputs: list[OutputTable]) -> FloatArray | None:
    """Return the band of each output outside of which a row fails, None without any. Shape (k, 2)."""
    for table in outputs:
        if table.accepted is not None and not table.accepted[0] < table.accepted[1]:
            low, high = table.accepted
            raise InputError(
                f"{path}: outputs[{table.name}]: accepted = [{low:g}, {high:g}] holds nothing; "
                "give the lower value first"
            )
    if all(table.accepted is None for table in outputs):
        return None
    return np.array([table.accepted or (-np.inf, np.inf) for table in outputs])
