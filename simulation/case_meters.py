"""Sums and counters of a case as the means that they are: energies of intervals, readings of meters."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case_data import CaseData
from simulation.case_file import CaseFile, InputTable, OutputTable
from simulation.errors import InputError, errors_at
from simulation.fmi.description import FmuDescription
from simulation.fmi.variable import FmuVariable
from simulation.recording import Recording
from simulation.units import in_si

_EVEN = 0.01
"""Readings are as far apart as usual where that differs by less than this share: clocks have seconds."""


def inputs_as_means(file: CaseFile, fmu: FmuDescription) -> CaseFile:
    """Return a case whose inputs that are sums, as kWh of an hour, are means in the FMU's unit.

    Args:
        file: The case file's content.
        fmu: What the FMU says of itself.

    Raises:
        InputError: If a sum is of something else than the input.
    """
    return file.model_copy(update={"inputs": [_input_as_mean(one, fmu) for one in file.inputs]})


def outputs_as_means(file: CaseFile, fmu: FmuDescription, data: CaseData) -> tuple[CaseFile, CaseData]:
    """Return a case whose outputs that are sums, or counters of a rate, are means in the FMU's unit.

    A counter of what the FMU counts itself stays one, without the places where it began at 0 again.

    Args:
        file: The case file's content.
        fmu: What the FMU says of itself.
        data: The recordings.

    Returns:
        The case, and the recordings with the columns that it names.

    Raises:
        InputError: If what is counted is something else than the output, or a counter falls.
    """
    recordings, outputs = dict(data.recordings), list[OutputTable]()
    for table in file.outputs:
        is_counted = table.sum_over_s is not None or table.starts_at is not None
        if table.source is not None and (is_counted or table.replicates is not None):
            with errors_at(f"outputs[{table.name}]"):
                name, recording = table.source[0], recordings[table.source[0]]
                if is_counted:
                    change, columns = _output_as_mean(table, fmu, recording)
                else:
                    change, columns = _mean_of_replicates(table, recording)
                recordings[name] = replace(recording, columns={**recording.columns, **columns})
                table = table.model_copy(update=change)
        outputs.append(table)
    return file.model_copy(update={"outputs": outputs}), replace(data, recordings=recordings)


def _input_as_mean(table: InputTable, fmu: FmuDescription) -> InputTable:
    if table.sum_over_s is None:
        return table
    where = f"inputs[{table.name}]"
    with errors_at(where):
        variable = fmu.require(table.name, "input", where)
        rate = _rate(table.unit, variable, fmu)
        if rate is None:
            raise InputError(_no_rate(table, variable))
        weights = {column: weight * rate / table.sum_over_s for column, weight in table.weights.items()}
    return table.model_copy(
        update={
            "column": None,
            "sum": weights,
            "unit": variable.unit,
            "mean_over_s": table.sum_over_s,
            "sum_over_s": None,
        }
    )


def _output_as_mean(
    table: OutputTable, fmu: FmuDescription, recording: Recording
) -> tuple[Mapping[str, Any], Mapping[str, FloatArray]]:
    """Return the keys of an output that change, and the columns that it has then. Shape (m,) each."""
    variable = fmu.require(table.name, "output", f"outputs[{table.name}]")
    assert table.column is not None, "asked of an output that is measured"
    rate = _rate(table.unit, variable, fmu, may_be_unknown=table.starts_at is not None)
    values, column = recording.columns[table.column], f"{table.column} for {table.name}"
    if table.starts_at is None:
        if rate is None:
            raise InputError(_no_rate(table, variable))
        assert table.sum_over_s is not None, "a sum or a counter"
        length_s, scale, means = table.sum_over_s, rate / table.sum_over_s, values * rate / table.sum_over_s
    else:
        values = _without_wraps(table, recording, values)
        if rate is None:
            return {"column": column}, {column: values}
        length_s, means = _means_between(recording, values * rate)
        # Two readings make a mean, each with its error.
        scale = math.sqrt(2.0) * rate / length_s
    change: dict[str, Any] = {
        "column": column,
        "unit": variable.unit,
        "mean_over_s": length_s,
        "sum_over_s": None,
        "starts_at": None,
        "wraps_at": None,
        "uncertainty": table.uncertainty and table.uncertainty * scale,
    }
    if table.uncertainty_column is None:
        return change, {column: means}
    own = recording.columns[table.uncertainty_column]
    uncertain = f"{table.uncertainty_column} for {table.name}"
    return change | {"uncertainty_column": uncertain}, {column: means, uncertain: own * scale}


def _mean_of_replicates(
    table: OutputTable, recording: Recording
) -> tuple[Mapping[str, Any], Mapping[str, FloatArray]]:
    """Return the keys of an output that change, and the mean of its replicates as columns. Shape (m,) each.

    Where nothing is said of the uncertainty, all replicates count as equally sure: their deviation is pooled
    over all times, as few at one time say little of it.
    """
    assert table.replicates is not None, "asked of an output with replicates"
    assert table.source is not None, "asked of an output that is measured"
    values = np.stack([recording.columns[name] for name in table.replicates])
    known = ~np.isnan(values)
    n = known.sum(axis=0)
    mean = np.where(n > 0, np.where(known, values, 0.0).sum(axis=0) / np.maximum(n, 1), np.nan)
    deviation = table.uncertainty
    if deviation is None:
        freedom = int(np.maximum(n - 1, 0).sum())
        squares = float(np.sum(np.where(known, values - mean, 0.0) ** 2))
        if not (freedom > 0 and squares > 0.0):
            raise InputError(
                "replicates do not differ, so nothing is known of their uncertainty; add uncertainty"
            )
        deviation = math.sqrt(squares / freedom)
    uncertain = np.where(n > 0, deviation / np.sqrt(np.maximum(n, 1)), np.nan)
    names = table.source[1], f"{table.source[1]}, uncertainty"
    change = {"column": names[0], "replicates": None, "uncertainty": None, "uncertainty_column": names[1]}
    return change, dict(zip(names, (mean, uncertain), strict=True))


def _rate(
    unit: str, variable: FmuVariable, fmu: FmuDescription, *, may_be_unknown: bool = False
) -> float | None:
    """Return what one unit of a sum is in the FMU's unit times seconds; None where it is of the FMU's kind.

    Args:
        unit: Unit of the sum.
        variable: What is summed.
        fmu: What the FMU says of itself.
        may_be_unknown: Whether the FMU need not say its unit.

    Raises:
        InputError: If it is neither, or nothing is known of the FMU's unit.
    """
    if not variable.unit:
        if may_be_unknown:
            return None
        raise InputError(
            f"the FMU declares no unit for {variable.name}; say in fmu_unit what its equations count in, so "
            "that sums can be compared"
        )
    mine, theirs = in_si(unit, fmu.units), in_si(variable.unit, fmu.units)
    if theirs is not None and theirs.offset:
        raise InputError(
            f"{variable.unit} has a zero of its own, so its sums depend on it; write mean_over_s"
        )
    if mine is None or theirs is None:
        unknown = unit if mine is None else variable.unit
        raise InputError(f'unit "{unknown}" is not known; give fmu_unit and unit as products of usual ones')
    powers = Counter(dict(theirs.exponents))
    powers["s"] += 1
    if mine.exponents == tuple(sorted((name, n) for name, n in powers.items() if n)):
        return float(mine.factor / theirs.factor)
    if mine.exponents == theirs.exponents:
        return None
    raise InputError(
        f'unit = "{unit}" is neither of the kind of the FMU\'s "{variable.unit}" nor that times a time; '
        "correct it"
    )


def _no_rate(table: InputTable | OutputTable, variable: FmuVariable) -> str:
    advice = ' or, of an output that counts itself, starts_at = "first"' * isinstance(table, OutputTable)
    return (
        f'unit = "{table.unit}" is of the kind of the FMU\'s "{variable.unit}", and the sum of a rate over a '
        f"time is not; correct unit, or write mean_over_s{advice}"
    )


def _without_wraps(table: OutputTable, recording: Recording, values: FloatArray) -> FloatArray:
    """Return what a counter counted in all, without the places where it began at 0 again. Shape (m,)."""
    known = np.flatnonzero(~np.isnan(values))
    steps = np.diff(values[known])
    # Net meters run back a little; one that was replaced or began at 0 again falls far.
    far = 0.5 * (table.wraps_at or float(np.ptp(values[known])) if len(known) else 0.0)
    falls = steps < (-far if table.wraps_at is None else 0.0)
    for row in np.flatnonzero(falls):
        before, after = values[known[row]], values[known[row + 1]]
        said = f"falls from {before:.12g} to {after:.12g} in line {known[row + 1] + recording.first_line}"
        if table.wraps_at is None:
            raise InputError(
                f"{recording.path}: {table.column} {said}; if it began at 0 again there, say where: wraps_at "
                "= ..., or choose a window before or after it"
            )
        if before - after < far or before > table.wraps_at:
            raise InputError(
                f"{recording.path}: {table.column} {said}, and wraps_at = {table.wraps_at:g}; correct one"
            )
    counted = values.copy()
    counted[known[1:]] += (table.wraps_at or 0.0) * np.cumsum(falls)
    return counted


def _means_between(recording: Recording, counted: FloatArray) -> tuple[float, FloatArray]:
    """Return the usual distance of readings [s], and the mean rate up to each reading, NaN after a gap.

    Args:
        recording: Where they stand.
        counted: The readings. Shape (m,). [FMU's unit times s]
    """
    known = np.flatnonzero(~np.isnan(counted))
    distances = np.diff(recording.time[known])
    length_s = float(np.median(distances)) if len(distances) else math.nan
    is_usual = np.abs(distances - length_s) <= _EVEN * length_s
    if 2 * np.count_nonzero(is_usual) <= len(distances):
        raise InputError(
            f"{recording.path}: readings of a counter have to lie equally far apart, and most do not; let "
            "the FMU count itself, or write a file of readings at even times"
        )
    means = np.full(len(counted), np.nan)
    means[known[1:]] = np.where(is_usual, np.diff(counted[known]) / distances, np.nan)
    return length_s, means
