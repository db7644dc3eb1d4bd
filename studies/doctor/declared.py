"""What can be said of a case before anything is simulated: declarations, data, units that cannot be right."""

from collections.abc import Iterator

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case import Case
from simulation.case_data import GAP_STEPS
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.time_unit import DAY_S, period_text, unit_for
from studies.doctor.finding import LONGEST, Finding, finding, named
from studies.report.wording import count

COLDEST_K, COLDEST_DEGC = 150.0, -100.0
LIKE_KELVIN = (200.0, 400.0)
"""Values in degC that all lie in between are rather in kelvin."""
FEW, FAR = 200, 10.0
"""One value of so many may be far from the others: farther than so many times their own span."""
MANY = 0.2
"""Share of the values that may be one and the same far value, which stands for no value."""
BARE = 0.05
"""Share of the window at its begin or end that may be without measured values, as a gap may lie there."""


def look_at_declaration(case: Case) -> Iterator[Finding]:
    """Look at what the case and the FMU declare."""
    fmu, space, convert = case.fmu, case.parameter_space, case.settings.parameters_for_fmu
    parameters, inputs = [fmu.variables[name] for name in space.names], case.scenario.input_names
    sizes = {"parameter": len(parameters), "input": len(inputs), "output": len(case.outputs)}
    counts = {f"{noun}s": count(n, noun) for noun, n in sizes.items()}
    yield finding("declared", "ok", fmu=fmu.path.name, **counts)
    yield _fmu(case)
    every = [fmu.variables[name] for name in fmu.names("input")]
    yield from named("inputs-left-alone", [one.name for one in every if one.is_out_of_reach])
    used = [fmu.variables[name] for name in (*inputs, *(output.name for output in case.outputs))]
    bare = [one.name for one in (*used, *parameters) if one.kind in REAL_KINDS and not one.unit]
    yield from named("no-unit", bare, n=count(len(bare), "variable"))
    boxes = zip(parameters, convert(space.lower), convert(space.upper), strict=True)
    beyond = [f"{one.name} ({_ends(one)})" for one, *box in boxes if _is_beyond(one, *box)]
    for name, value in case.fixed.items():
        one = fmu.variables[name]
        if not isinstance(value, str | bool) and _is_beyond(one, value, value):
            beyond.append(f"{name} = {value:g} ({_ends(one)})")
    yield from named("beyond", beyond)


def look_at_data(case: Case) -> Iterator[Finding]:
    """Look at the recordings, as the model and the comparison get them."""
    measurement, scenario = case.measurement, case.scenario
    n_samples, p = measurement.n_samples, case.parameter_space.n_parameters
    partly = list(_partly_covered(case))
    remedies = ["shorten the window, or measure all of it: the rest is not calibrated"] * bool(partly)
    if n_samples <= p:
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
    inputs = dict(zip(scenario.input_names, scenario.inputs.T, strict=True))
    outputs = list(zip(case.outputs, measurement.samples, strict=True))
    series = [*inputs.items(), *((one.name, samples.values) for one, samples in outputs)]
    yield from named("constant", [name for name, v in series if len(v) > 1 and np.ptp(v) == 0.0])
    far, far_inputs, problems = [], [], []
    for name, values in inputs.items():
        unit, (floor, low, high) = case.fmu.variables[name].unit, _usual(values)
        if values.min() < floor:
            at_s = scenario.time_communication[int(np.argmin(values))]
            least = f"{values.min():.6g} {unit}".rstrip()
            far_inputs.append(f"{name} falls to {least} at {at_s:.12g} s, mostly {low:.4g} to {high:.4g}")
        problems.append((name, unit_problem(values[values >= floor], unit)))
    for output, samples in outputs:
        is_far, unit = _is_far(samples.values), f" {output.unit}".rstrip()
        others, at = samples.values[~is_far], np.flatnonzero(is_far)
        if len(at):
            more = f" and {len(at) - 1} more" if len(at) > 1 else ""
            far.append(
                f"{output.name}: {samples.values[at[0]]:.6g}{unit} at {samples.time[at[0]]:.12g} s{more}; "
                f"the others lie between {others.min():.4g} and {others.max():.4g}{unit}"
            )
        problems.append((f"measured {output.name}", unit_problem(others, output.unit)))
    yield from named("far", far, "; ")
    yield from named("far-inputs", far_inputs, "; ")
    yield from named("units-of-data", [f"{name}: {problem}" for name, problem in problems if problem], "; ")


def unit_problem(values: FloatArray, unit: str) -> str:
    """Say what speaks against a temperature unit; "" for nothing.

    Args:
        values: Finite values. Shape (n,). [unit]
        unit: The unit they are said to have.
    """
    low, high = float(np.min(values)), float(np.max(values))
    span = f"{low:.4g} to {high:.4g} {unit}"
    if unit == "K" and low < COLDEST_K:
        return f"{span} is very cold: rather degC"
    if unit in ("degC", "°C") and low < COLDEST_DEGC:
        return f"{span} is very cold: 273.15 may be taken off twice"
    if unit in ("degC", "°C") and LIKE_KELVIN[0] < low and high < LIKE_KELVIN[1]:
        return f"{span} is very hot: rather K"
    return ""


def _fmu(case: Case) -> Finding:
    fmu, interface = case.fmu, case.fmu.interfaces[case.interface]
    said = f"FMI {fmu.fmi_version} {case.interface} by {fmu.generation_tool or 'an unnamed tool'}"
    said += ", one instance per process" * interface.can_be_instantiated_only_once_per_process
    if interface.needs_execution_tool:
        return finding("fmu-needs-its-tool", said=said)
    return finding("fmu", "ok", said=said)


def _partly_covered(case: Case) -> Iterator[str]:
    """Say which outputs are not measured at the begin or the end of the window, and when they are."""
    begin_s, end_s = (float(case.measurement.time[i]) for i in (0, -1))
    unit = unit_for(case.window_d[1] * DAY_S)
    for output, samples in zip(case.outputs, case.measurement.samples, strict=True):
        bare_s = max(GAP_STEPS * float(np.median(np.diff(samples.time))), BARE * (end_s - begin_s))
        first_s, last_s = float(samples.time[0]), float(samples.time[-1])
        first, last = (unit.moment(case.window_d[0] + (at - begin_s) / DAY_S) for at in (first_s, last_s))
        covered = f" from {first}" * (first_s - begin_s > bare_s) + f" to {last}" * (end_s - last_s > bare_s)
        if covered:
            yield f"{output.name} is covered{covered} of {unit.period(case.window_d)}"


def _usual(values: FloatArray) -> tuple[float, float, float]:
    """Return what nine tenths of an input's values lie between, after what none can have meant below it.

    Far above them rain or a tap may be; and where a single cell is wrong, many interpolated values are.
    """
    low, high = (float(one) for one in np.quantile(values, (0.05, 0.95)))
    return (low - FAR * (high - low) if low < high else -np.inf), low, high


def _is_far(values: FloatArray) -> BoolArray:
    """Say which values lie far from all others: a few, or more that are all the same. Shape (n,)."""
    n_most = max(1, len(values) // FEW)
    others = np.sort(values)[n_most:-n_most]
    far = np.zeros(len(values), dtype=np.bool_)
    if len(others) and others[0] < others[-1]:
        far = np.maximum(others[0] - values, values - others[-1]) > FAR * float(others[-1] - others[0])
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
