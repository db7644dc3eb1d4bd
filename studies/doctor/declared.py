"""What can be said of a case before anything is simulated: declarations, data, units that cannot be right."""

from collections.abc import Iterator

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case import Case
from simulation.case_data import GAP_STEPS
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.time_unit import DAY_S, period_text, unit_for
from studies.doctor.finding import LONGEST, Finding, finding, named
from studies.words.wording import count

COLDEST_K, COLDEST_DEGC = 150.0, -100.0
LIKE_KELVIN = (200.0, 400.0)
"""Values in degC that all lie in between are rather in kelvin."""
FEW, FAR = 200, 10.0
"""One value of so many may be far: farther from its neighbours than so many times what others are from
theirs or, of values that are all the same, farther from the others than so many times their span."""
N_BESIDE, STEPS = 3, 2.0
"""Neighbours on each side, and how many times the largest step between others is far. By hand."""
MANY = 0.2
"""Share of the values that may be one and the same far value, which stands for no value."""
PYTHON = "python"
"""In the name of what exports Python scripts, as PythonFMU: these need an interpreter, and no tool."""
BARE = 0.05
"""Share of the window at its begin or end that may be without measured values, as a gap may lie there."""


def look_at_declaration(case: Case) -> Iterator[Finding]:
    """Look at what the case and the FMU declare."""
    fmu, space, convert = case.fmu, case.parameter_space, case.settings.parameters_for_fmu
    parameters = [fmu.variables[name] for name in case.settings.set_names]
    inputs = case.scenario.input_names
    bare = undeclared(case)
    sizes = {"parameter": len(parameters), "input": len(inputs), "output": len(case.outputs)}
    counts = {f"{noun}s": count(n, noun) for noun, n in sizes.items()}
    yield finding("declared", "ok", fmu=fmu.path.name, **counts)
    yield _fmu(case)
    every = [fmu.variables[name] for name in fmu.names("input")]
    yield from named("inputs-left-alone", [one.name for one in every if one.is_out_of_reach])
    yield from named("no-unit", bare, n=count(len(bare), "variable"))
    boxes = zip(parameters, convert(space.lower), convert(space.upper), strict=True)
    beyond = [f"{one.name} ({_ends(one)})" for one, *box in boxes if _is_beyond(one, *box)]
    for name, value in case.fixed.items():
        one = fmu.variables[name]
        if not isinstance(value, str | bool) and _is_beyond(one, value, value):
            beyond.append(f"{name} = {value:g} ({_ends(one)})")
    yield from named("beyond", beyond)
    yield from named("files", [f"{name} {why}" for name, why in case.named_files.unknown.items()], "; ")


def undeclared(case: Case) -> list[str]:
    """Return the inputs, outputs and parameters without a unit."""
    names = (*case.scenario.input_names, *(one.name for one in case.outputs), *case.settings.set_names)
    used = [case.fmu.variables[name] for name in names]
    return [one.name for one in used if one.kind in REAL_KINDS and not one.unit]


def n_values(case: Case) -> int:
    """Return the number of measured values that a single experiment is compared with."""
    return sum(len(one.samples.time) for one in case.outputs if one.is_measured)


def look_at_number_of_values(case: Case) -> Finding:
    """Say whether all experiments together have as many values as their parameters need."""
    p, n_experiments = case.parameter_space.n_parameters, count(len(case.experiments), "experiment")
    n = sum(n_values(one) for one in case.experiments)
    found = f"{n_experiments}: {count(n, 'measured value')} for {count(p, 'parameter')}"
    remedy = "lengthen the windows, add experiments, or fix parameters"
    return finding("values", "warn" if n <= p else "ok", found=found, remedy=remedy)


def look_at_data(case: Case) -> Iterator[Finding]:
    """Look at the recordings, as the model and the comparison get them.

    Whether the values are enough is said of single cases alone, see `look_at_number_of_values`.
    """
    scenario, p = case.scenario, case.parameter_space.n_parameters
    n_samples = n_values(case)
    partly = list(_partly_covered(case))
    rest = "the rest is not calibrated; measure all of it, or shorten the window"
    remedies = [f"{rest} (a later begin needs start_d or start_s)"] * bool(partly)
    if n_samples <= p and not case.experiment:
        excess = f"{count(p, 'parameter')} cannot be found from {count(n_samples, 'value')}"
        remedies.append(excess if partly else f"{excess}; lengthen the window")
    yield finding(
        "data",
        "warn" if remedies else "ok",
        covered="; ".join(partly[:LONGEST]) or f"{period_text(case.window_d)} are covered",
        values=count(n_samples, "measured value"),
        step_s=case.communication_step_s,
        remedy="; ".join(remedies),
    )
    edges, variables = scenario.time_communication, case.fmu.variables
    series = [
        (name, variables[name].unit, edges, values, _is_far_below(values))
        for name, values in zip(scenario.input_names, scenario.inputs.T, strict=True)
    ]
    series += [
        (one.name, one.unit, one.samples.time, one.samples.values, _is_far(one.samples.values))
        for one in case.outputs
        if one.is_measured
    ]
    constant, far, problems = [], [], []
    for name, unit, time, values, is_far in series:
        others, at = values[~is_far], np.flatnonzero(is_far)
        if len(values) > 1 and np.ptp(values) == 0.0:
            constant.append(name)
        if len(at):
            value, more = f"{values[at[0]]:.6g} {unit}".rstrip(), f" and {len(at) - 1} more" * (len(at) > 1)
            far.append(
                f"{name}: {value} at {time[at[0]]:.12g} s{more}; the others lie between {others.min():.4g} "
                f"and {others.max():.4g}"
            )
        if problem := unit_problem(others, unit):
            problems.append(f"{name}: {problem}")
    yield from named("constant", constant)
    yield from named("far", far, "; ")
    yield from named("units-of-data", problems, "; ")


def unit_problem(values: FloatArray, unit: str) -> str:
    """Say what speaks against a temperature unit; "" for nothing.

    Args:
        values: Finite values. Shape (n,). [unit]
        unit: The unit they are said to have.
    """
    low, high = float(np.min(values)), float(np.max(values))
    span = f"{low:.4g} to {high:.4g} {unit}"
    if unit == "K" and low < COLDEST_K:
        return f"{span} is too cold: the values are probably in degC"
    if unit in ("degC", "°C") and low < COLDEST_DEGC:
        return f"{span} is too cold: a value is probably in degC where K is expected"
    if unit in ("degC", "°C") and LIKE_KELVIN[0] < low and high < LIKE_KELVIN[1]:
        return f"{span} is too hot: the values are probably in K"
    return ""


def _fmu(case: Case) -> Finding:
    fmu, interface = case.fmu, case.fmu.interfaces[case.interface]
    said = f"FMI {fmu.fmi_version} {case.interface} by {fmu.generation_tool or 'an unnamed tool'}"
    said += ", one instance per process" * interface.can_be_instantiated_only_once_per_process
    said += ", a binary for Windows that runs in Wine" * interface.is_for_windows
    if interface.needs_execution_tool and PYTHON in fmu.generation_tool.lower():
        # There is no tool, and no licence, to be had.
        return finding("fmu", "ok", said=f"{said}, runs in Python with the packages that it imports")
    if interface.needs_execution_tool:
        return finding("fmu-needs-its-tool", said=said)
    return finding("fmu", "ok", said=said)


def _partly_covered(case: Case) -> Iterator[str]:
    """Say which outputs are not measured at the begin or the end of the window, and when they are."""
    begin_s, end_s = (float(case.measurement.time[i]) for i in (0, -1))
    unit = unit_for(case.window_d[1] * DAY_S)
    for output in (one for one in case.outputs if one.is_measured):
        time = output.samples.time
        bare_s = max(GAP_STEPS * float(np.median(np.diff(time))), BARE * (end_s - begin_s))
        first_s, last_s = float(time[0]), float(time[-1])
        first, last = (unit.moment(case.window_d[0] + (at - begin_s) / DAY_S) for at in (first_s, last_s))
        covered = f" from {first}" * (first_s - begin_s > bare_s) + f" to {last}" * (end_s - last_s > bare_s)
        if covered:
            yield f"{output.name} is covered{covered} of {unit.period(case.window_d)}"


def _is_far_below(values: FloatArray) -> BoolArray:
    """Say which values of an input lie far below nine tenths of them, as none can have meant. Shape (n,).

    Far above them rain or a tap may be; and where a single cell is wrong, many interpolated values are.
    """
    low, high = np.quantile(values, (0.05, 0.95))
    far: BoolArray = (values < low - FAR * (high - low)) & (low < high)
    return far


def _is_far(values: FloatArray) -> BoolArray:
    """Say which values lie far from their neighbours: a few, or more that are all the same. Shape (n,)."""
    n, n_most = len(values), max(1, len(values) // FEW)
    far = np.zeros(n, dtype=np.bool_)
    if n > 2 * n_most + 2:
        # On a slope and beside a step a value lies between the medians of those before and after it.
        sides = np.lib.stride_tricks.sliding_window_view(np.pad(values, N_BESIDE - 1, "edge"), N_BESIDE)
        medians = np.median(sides, axis=1)
        before, inner, after = medians[: n - 2], values[1:-1], medians[N_BESIDE + 1 :]
        outside = np.maximum(np.minimum(before, after) - inner, inner - np.maximum(before, after))
        # One wrong value makes two large steps, to it and back.
        usual = float(np.sort(outside)[-n_most - 1])
        step = float(np.sort(np.abs(np.diff(values)))[-2 * n_most - 1])
        far[1:-1] = outside > max(FAR * usual, STEPS * step)
    for end in (values.min(), values.max()):
        same, rest = values == end, values[(values != end) & ~far]
        if 0 < same.sum() <= MANY * len(values) and len(rest) and np.ptp(rest) > 0.0:
            far |= same & (np.maximum(rest.min() - values, values - rest.max()) > FAR * np.ptp(rest))
    return far


def _is_beyond(variable: FmuVariable, lower: float, upper: float) -> bool:
    low, high = variable.minimum, variable.maximum
    return (low is not None and lower < low) or (high is not None and upper > high)


def _ends(variable: FmuVariable) -> str:
    ends = (variable.minimum, variable.maximum)
    return " to ".join("..." if end is None else f"{end:g}" for end in ends)
