"""From the tables of a case file to parts that agree with the FMU; every contradiction is found here."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from simulation.arrays import FloatArray
from simulation.case_data import CaseData
from simulation.case_file import (
    CaseFile,
    FirstMeasured,
    InputTable,
    OutputTable,
    ParameterTable,
    ValueWithUnit,
)
from simulation.errors import InputError, errors_at
from simulation.fmi.description import FmuDescription
from simulation.fmi.ties import Tie, sum_limit, tie
from simulation.fmi.variable import REAL_KINDS, FmuVariable, Value
from simulation.foreign_text import quoted, shortened
from simulation.parameters import SumLimit
from simulation.scenario import values_at_edges, values_over_steps
from simulation.units import Conversion, conversion


def with_units(fmu: FmuDescription, units: Mapping[str, str]) -> FmuDescription:
    """Return the description with units for variables that it declares none for, as many tools do.

    Args:
        fmu: The description.
        units: Units by variable; unknown names are reported by `conversions`.

    Raises:
        InputError: If the FMU declares another one.
    """
    changed = {}
    for name, unit in units.items():
        variable = fmu.variables.get(name)
        if variable is None:
            continue
        if variable.unit and variable.unit != unit:
            raise InputError(
                f'{name}: fmu_unit = "{unit}" contradicts the FMU\'s "{variable.unit}"; drop it, and '
                "give in unit what the CSV file holds"
            )
        changed[name] = replace(variable, unit=unit)
    return replace(fmu, variables={**fmu.variables, **changed}) if changed else fmu


def conversions(
    fmu: FmuDescription, causality: str, tables: Sequence[InputTable | OutputTable | ParameterTable]
) -> list[Conversion]:
    """Find what tables name in the FMU, and return how each gets from its unit into the FMU's.

    Args:
        fmu: What the FMU says of itself.
        causality: "parameter", "input" or "output".
        tables: The tables.

    Raises:
        InputError: If the FMU has no such variable, or its unit is of another kind.
    """
    found = []
    for table in tables:
        where = f"{causality}s[{table.name}]"
        variable = fmu.require(table.name, causality, where, may_be_input=causality == "parameter")
        found.append(_into(fmu, variable, table.unit, where))
    return found


def _into(fmu: FmuDescription, variable: FmuVariable, unit: str, where: str) -> Conversion:
    return conversion(unit, variable.unit, where, definitions=fmu.units, is_difference=variable.is_difference)


def check_inputs(file: CaseFile, fmu: FmuDescription) -> None:
    """Check that every input of the FMU has one source: a recording, a value, or that it is calibrated."""
    _check_arrays(file, fmu)
    driven, calibrated = [table.name for table in file.inputs], [table.name for table in file.parameters]
    for name in driven:
        for also, names in (("[fixed]", file.fixed), ("[[parameters]]", calibrated)):
            if name in names:
                keep = "keep [[inputs]] if it was recorded"
                raise InputError(f"inputs[{name}] is also in {also}; {keep}, and remove the other")
    for name in fmu.names("input"):
        # An input that nothing can set must not stop the others; `studies check` reports it.
        has_source = name in (*driven, *file.fixed, *calibrated, *file.tied)
        if not has_source and not fmu.variables[name].is_out_of_reach:
            raise InputError(
                f"the FMU's input {name} has no [[inputs]] entry; add one, else it stays at its start; "
                "or hold it at a value under [fixed], or calibrate it under [[parameters]]"
            )


def _check_arrays(file: CaseFile, fmu: FmuDescription) -> None:
    """Check that the elements of an array of inputs are all driven, or none: it is set as a whole."""
    driven = {table.name for table in file.inputs}
    arrays: dict[int, list[str]] = {}
    for name in fmu.names("input"):
        if fmu.variables[name].array:
            arrays.setdefault(fmu.variables[name].reference, []).append(name)
    for names in arrays.values():
        others = [name for name in names if name not in driven]
        if 0 < len(others) < len(names):
            raise InputError(
                f"the FMU's inputs {names[0]} to {names[-1]} are one array, which is set as a whole; drive "
                f"all of it by [[inputs]], also {others[0]}"
            )


def input_values(
    file: CaseFile, fmu: FmuDescription, data: CaseData, changes: Sequence[Conversion], edges: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Return every input over every step, and those that outputs see at the edges of steps. [FMU's units].

    Args:
        file: The case file's content.
        fmu: What the FMU says of itself.
        data: The recordings.
        changes: How each input gets into the FMU's unit.
        edges: Edges of the steps. Shape (m + 1,). [s]

    Returns:
        The inputs over the steps, shape (m, n_inputs). In model exchange, if an input is not held, those at
        the edges, shape (m + 1, n_inputs); else None, and outputs see their step's.
    """
    is_seen = file.interface == "model-exchange" and any(one.interpolation != "held" for one in file.inputs)
    inputs, at_edges = (np.zeros((n, len(file.inputs))) for n in (len(edges) - 1, len(edges)))
    for k, (table, change) in enumerate(zip(file.inputs, changes, strict=True)):
        with errors_at(f"inputs[{table.name}]"):
            variable, how = fmu.variables[table.name], table.course
            if variable.kind not in REAL_KINDS and how != "held":
                raise InputError(
                    f'interpolation = "{table.interpolation}", but the FMU\'s {table.name} is of type '
                    f'{variable.kind} and knows nothing in between; write interpolation = "held"'
                )
            for column, weight in table.weights.items():
                time, values = data.input_series(table, column, edges)
                inputs[:, k] += weight * values_over_steps(time, values, edges, interpolation=how)
                if is_seen:
                    at_edges[:, k] += weight * values_at_edges(time, values, edges, interpolation=how)
            for one in (inputs, at_edges):
                one[:, k] = change.factor * one[:, k] + change.offset
            variable.check_series(inputs[:, k], edges, " + ".join(table.weights))
    return inputs, at_edges if is_seen else None


def ties(file: CaseFile, fmu: FmuDescription) -> tuple[Tie, ...]:
    """Return the parameters that follow from others.

    Raises:
        InputError: If the FMU has no such parameter, or an expression is wrong.
    """
    known = {table.name for table in file.parameters}
    for name in file.fixed:
        if fmu.find(name, "parameter", f"fixed.{name}", may_be_input=True).kind in REAL_KINDS:
            known.add(name)
    for name in file.tied:
        fmu.require(name, "parameter", f"tied.{name}", may_be_input=True)
    return tuple(tie(name, expression, known, fmu) for name, expression in file.tied.items())


def constraints(file: CaseFile) -> tuple[tuple[tuple[str, str], ...], tuple[SumLimit, ...]]:
    """Return the pairs of parameters of which the first one stays at or below the second one, and the sums.

    Raises:
        InputError: If one is neither, has other names, or meets a prior or an estimate that it contradicts.
    """
    tables = {table.name: table for table in file.parameters}
    pairs, sums = list[tuple[str, str]](), list[SumLimit]()
    for text in file.constraints:
        where = f"constraints: {quoted(text)}"
        parts = [part.strip() for part in text.split("<")]
        # Names need be no words of an expression.
        is_pair = len(parts) == 2 and all(part in tables for part in parts) and parts[0] != parts[1]
        limit = SumLimit(((parts[0], 1.0), (parts[1], -1.0)), 0.0) if is_pair else sum_limit(text, where)
        names = [name for name, _ in limit.terms]
        for name in names:
            if name not in tables:
                raise InputError(
                    f"{where}: {shortened(name)} is not calibrated; narrow the other one's bounds"
                )
            if tables[name].prior is not None:
                raise InputError(
                    f"{where}: {name} has a prior, which no parameter of a constraint can have; "
                    "remove one of the two"
                )
        units = list(dict.fromkeys(tables[name].unit for name in names))
        if len(units) > 1:
            raise InputError(f"{where}: units are {' and '.join(units)}; declare all in one unit")
        estimates = [tables[name].estimate for name in names]
        known = [estimate for estimate in estimates if estimate is not None]
        weights = [weight for _, weight in limit.terms]
        if len(known) == len(names) and np.dot(weights, known) > limit.most:
            raise InputError(f"{where}: the estimates violate it; correct them")
        if limit.most == 0.0 and sorted(weights) == [-1.0, 1.0]:
            small, large = sorted(names, key=lambda name: -dict(limit.terms)[name])
            pairs.append((small, large))
        else:
            order = [*tables]
            terms = tuple(sorted(limit.terms, key=lambda term: order.index(term[0])))
            sums.append(SumLimit(terms, limit.most))
    often = Counter(name for one in sums for name, _ in one.terms)
    often.update({name for pair in pairs for name in pair})
    for one in sums:
        for name, _ in one.terms:
            if often[name] > 1:
                raise InputError(
                    f"constraints: {name} is in a sum and in another constraint; keep one of them"
                )
    return tuple(pairs), tuple(sums)


def fixed_values(file: CaseFile, fmu: FmuDescription, data: CaseData, start_s: float) -> dict[str, Value]:
    """Return the parameters held at a value. [FMU's units].

    Args:
        file: The case file's content.
        fmu: What the FMU says of itself.
        data: The recordings, for first measured values.
        start_s: Start of the simulation. [s]
    """
    values: dict[str, Value] = {}
    for name, value in file.fixed.items():
        where = f"fixed.{name}"
        variable = fmu.find(name, "parameter", where, may_be_input=True)
        if isinstance(value, FirstMeasured | ValueWithUnit):
            if variable.kind not in REAL_KINDS:
                raise InputError(
                    f"{where}: {name} is of type {variable.kind}, which has no unit; give the value alone"
                )
            number, unit = _with_unit(file, data, value, start_s, where)
            change = _into(fmu, _with_a_unit(variable, value, unit, fmu, where), unit, where)
            value = number * change.factor + change.offset
        values[name] = variable.held_at(value, where)
    return values


def _with_a_unit(
    variable: FmuVariable,
    value: FirstMeasured | ValueWithUnit,
    unit: str,
    fmu: FmuDescription,
    where: str,
) -> FmuVariable:
    """Return a variable with its own unit, or with that of the output whose measured value it gets.

    Raises:
        InputError: If neither is known: a number in `unit` may be off by 273 or by a thousand then.
    """
    if variable.unit or unit in ("", "1"):
        return variable
    if isinstance(value, ValueWithUnit):
        raise InputError(
            f"{where}: the FMU declares no unit for {variable.name}, so {value.value:g} {unit} cannot be "
            "converted; give the number alone, in the unit of the FMU's equations"
        )
    if source := fmu.variables[value.first_measured].unit:
        return replace(variable, unit=source)
    raise InputError(
        f"{where}: the FMU declares no unit for {variable.name} and none for {value.first_measured}; say in "
        f"outputs[{value.first_measured}] what its equations count in, as fmu_unit, or give a number"
    )


def _with_unit(
    file: CaseFile, data: CaseData, value: FirstMeasured | ValueWithUnit, start_s: float, where: str
) -> tuple[float, str]:
    if isinstance(value, ValueWithUnit):
        return value.value, value.unit
    outputs = {table.name: table for table in file.outputs}
    table = outputs.get(value.first_measured)
    if table is None:
        raise InputError(
            f'{where}: first_measured = "{value.first_measured}" is no output of the case; '
            f"choose one of: {shortened(', '.join(outputs), 1000)}"
        )
    with errors_at(where):
        return data.first_measured(table, start_s), table.unit
