"""What can be said of a case before anything is simulated: declarations, data, units that cannot be right."""

import re
from collections.abc import Iterator

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case import Case
from simulation.case_data import GAP_STEPS
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.parameters import ParameterSpace
from simulation.time_unit import DAY_S, period_text, unit_for
from studies.calibration.prior import Prior
from studies.doctor.finding import Finding
from studies.report.wording import count, difference_unit, quantity, squared

COLDEST_K, COLDEST_DEGC = 150.0, -100.0
LIKE_KELVIN = (200.0, 400.0)
"""Values in degC that all lie in between are rather in kelvin."""
FEW, FAR = 200, 10.0
"""One value of so many may be far from the others: farther than so many times their own span."""
MANY = 0.2
"""Share of the values that may be one and the same far value, which stands for no value."""
BARE = 0.05
"""Share of the window at its begin or end that may be without measured values, as a gap may lie there."""
LONGEST = 4
"""Names in one line."""


def look_at_declaration(case: Case) -> Iterator[Finding]:
    """Look at what the case and the FMU declare."""
    yield _names(case)
    yield _fmu(case)
    yield from _left_alone(case)
    yield from _no_unit(case)
    yield from _outside_the_fmus_bounds(case)
    yield from _priors(case)


def look_at_data(case: Case) -> Iterator[Finding]:
    """Look at the recordings, as the model and the comparison get them."""
    measurement, scenario = case.measurement, case.scenario
    n_samples, p = measurement.n_samples, case.parameter_space.n_parameters
    partly = list(_partly_covered(case))
    remedies = ["shorten the window, or measure all of it: the rest is not calibrated"] * bool(partly)
    if n_samples <= p:
        excess = f"{count(p, 'parameter')} cannot be found from {count(n_samples, 'value')}"
        remedies.append(excess if partly else f"{excess}; lengthen the window")
    yield Finding(
        "data",
        "warn" if remedies else "ok",
        f"{'; '.join(partly[:LONGEST]) or f'{period_text(case.window_d)} are covered'}: "
        f"{count(n_samples, 'measured value')}, communication step {case.communication_step_s:g} s",
        "; ".join(remedies),
    )
    series = {name: scenario.inputs[:, i] for i, name in enumerate(scenario.input_names)}
    still = [name for name, values in series.items() if np.ptp(values) == 0.0]
    still += [
        output.name
        for output, samples in zip(case.outputs, measurement.samples, strict=True)
        if len(samples.values) > 1 and np.ptp(samples.values) == 0.0
    ]
    if still:
        yield Finding(
            "series that never change",
            "warn",
            f"constant over the window: {_listed(still)}",
            "see whether the CSV column is the right one and is filled",
        )
    yield from _far_from_others(case)
    yield from _data_in_wrong_unit(case, series)


def temperature_doubt(values: FloatArray, unit: str) -> str:
    """Say what speaks against a temperature unit; "" for nothing.

    Args:
        values: Finite values. Shape (n,). [unit]
        unit: The unit they are said to have.
    """
    low, high = float(np.min(values)), float(np.max(values))
    span = f"{low:.4g} to {high:.4g} {unit}"
    if unit == "K" and low < COLDEST_K:
        return f"{span} is very cold: rather degC"
    if unit in ("degC", "°C"):
        if low < COLDEST_DEGC:
            return f"{span} is very cold: 273.15 may be taken off twice"
        if LIKE_KELVIN[0] < low and high < LIKE_KELVIN[1]:
            return f"{span} is very hot: rather K"
    return ""


def _partly_covered(case: Case) -> Iterator[str]:
    """Say which outputs are not measured at the begin or the end of the window, and when they are."""
    begin_s, end_s = (float(case.measurement.time[i]) for i in (0, -1))
    unit = unit_for(case.window_d[1] * DAY_S)
    for output, samples in zip(case.outputs, case.measurement.samples, strict=True):
        bare_s = max(GAP_STEPS * float(np.median(np.diff(samples.time))), BARE * (end_s - begin_s))
        first, last = (case.window_d[0] + (float(samples.time[i]) - begin_s) / DAY_S for i in (0, -1))
        covered = "covered"
        if samples.time[0] - begin_s > bare_s:
            covered += f" from {unit.moment(first)}"
        if end_s - samples.time[-1] > bare_s:
            covered += f" to {unit.moment(last)}"
        if covered != "covered":
            yield f"{output.name} is {covered} of {unit.period(case.window_d)}"


def _far_from_others(case: Case) -> Iterator[Finding]:
    """Look for single values that no sensor can have meant, as -9999 where nothing was measured."""
    for output, samples in zip(case.outputs, case.measurement.samples, strict=True):
        values = samples.values
        is_far = _is_far(values)
        far = np.flatnonzero(is_far)
        if len(far):
            low, high = values[~is_far].min(), values[~is_far].max()
            more = f" and {len(far) - 1} more" if len(far) > 1 else ""
            unit = f" {output.unit}" if output.unit else ""
            yield Finding(
                "values far from all others",
                "warn",
                f"{output.name}: {values[far[0]]:.6g}{unit} at {samples.time[far[0]]:.12g} s{more}; the "
                f"others lie between {low:.4g} and {high:.4g}{unit}",
                "leave the cell empty where nothing was measured",
            )
    scenario, below = case.scenario, []
    for name, values in zip(scenario.input_names, scenario.inputs.T, strict=True):
        floor, low, high = _usual(values)
        if values.min() < floor:
            unit, at_s = case.fmu.variables[name].unit, scenario.time_communication[int(np.argmin(values))]
            least = f"{values.min():.6g} {unit}".rstrip()
            below.append(f"{name} falls to {least} at {at_s:.12g} s, mostly {low:.4g} to {high:.4g}")
    if below:
        yield Finding(
            "inputs far below all others",
            "warn",
            "; ".join(below[:LONGEST]),
            "leave cells empty where nothing was measured, and give such an input max_gap_s",
        )


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
        span = float(others[-1] - others[0])
        far = np.maximum(others[0] - values, values - others[-1]) > FAR * span
    for end in (values.min(), values.max()):
        same, rest = values == end, values[(values != end) & ~far]
        if 0 < same.sum() <= MANY * len(values) and len(rest) and np.ptp(rest) > 0.0:
            far |= same & (np.maximum(rest.min() - values, values - rest.max()) > FAR * np.ptp(rest))
    return far


def _names(case: Case) -> Finding:
    n_inputs = len(case.scenario.input_names)
    return Finding(
        "names, units, bounds",
        "ok",
        f"{count(case.parameter_space.n_parameters, 'parameter')}, {count(n_inputs, 'input')} and "
        f"{count(len(case.outputs), 'output')} are in {case.fmu.path.name}, units agree",
    )


def _fmu(case: Case) -> Finding:
    fmu = case.fmu
    interface = fmu.interfaces[case.interface]
    can = [
        word
        for word, has in (
            ("state can be saved", interface.can_get_and_set_state),
            ("one instance per process", interface.can_be_instantiated_only_once_per_process),
        )
        if has
    ]
    said = f"FMI {fmu.fmi_version} {case.interface} by {fmu.generation_tool or 'an unnamed tool'}"
    found = ", ".join([said, *can])
    if interface.needs_execution_tool:
        return Finding(
            "FMU",
            "warn",
            f"{found}, needs its tool to run",
            "have the tool, and a licence for each worker, on every machine; limit them: "
            "[simulation] max_workers",
        )
    if fmu.complaint:
        return Finding(
            "FMU",
            "warn",
            f"{found}; its description breaks the standard: {_first(fmu.complaint)}",
            "it is used as it is; have its exporter corrected if names or units look wrong",
        )
    return Finding("FMU", "ok", found)


def _priors(case: Case) -> Iterator[Finding]:
    space = case.parameter_space
    known = [one.name for one in space.parameters if one.prior is not None]
    if known:
        prior = Prior.of(space, case.measurement)
        assert prior is not None, "some parameter declares one"
        unit = squared(difference_unit(case.outputs[0].unit))
        yield Finding(
            "priors",
            "ok",
            f"{_listed(known)} of {count(space.n_parameters, 'parameter')}; one standard deviation weighs as "
            f"much as {quantity(prior.weight, unit)} of MSE",
        )


def _left_alone(case: Case) -> Iterator[Finding]:
    variables = [case.fmu.variables[name] for name in case.fmu.names("input")]
    if left := [one.name for one in variables if one.is_out_of_reach]:
        yield Finding(
            "inputs that cannot be driven",
            "warn",
            f"arrays, clocks or bytes, which stay as they start: {_listed(left)}",
            "export the FMU with scalar inputs instead, if they matter",
        )


def _first(complaint: str) -> str:
    """Return the first of several complaints, and how many there are."""
    each = complaint.removeprefix("Failed to validate modelDescription.xml:").split(" - ")
    each = [one.strip(" -.") for one in each if one.strip(" -.")]
    more = f" (and {len(each) - 1} more)" if len(each) > 1 else ""
    return (each[0] if each else complaint)[:200] + more


def _no_unit(case: Case) -> Iterator[Finding]:
    used = [
        *case.scenario.input_names,
        *(output.name for output in case.outputs),
        *case.parameter_space.names,
    ]
    variables = [case.fmu.variables[name] for name in used]
    bare = [one.name for one in variables if one.kind in REAL_KINDS and not one.unit]
    if bare:
        yield Finding(
            "units the FMU does not declare",
            "warn",
            f"{count(len(bare), 'variable')} without a unit: {_listed(bare)}",
            "see that data and bounds are what its equations expect; for inputs and outputs fmu_unit says it",
        )


def _outside_the_fmus_bounds(case: Case) -> Iterator[Finding]:
    space, convert = case.parameter_space, case.settings.parameters_for_fmu
    variables = [case.fmu.variables[name] for name in space.names]
    wanted = zip(variables, convert(space.lower), convert(space.upper), strict=True)
    beyond = [
        f"{variable.name} ({_ends(variable)})"
        for variable, lower, upper in wanted
        if _is_beyond(variable, lower, upper)
    ]
    if beyond:
        yield Finding(
            "bounds inside the FMU's min and max",
            "warn",
            f"wider than the FMU allows: {_listed(beyond)}",
            "narrow lower and upper; tools differ in what they do beyond",
        )
    numbers = {name: value for name, value in case.fixed.items() if not isinstance(value, str | bool)}
    held = [
        f"{name} = {value:g} ({_ends(case.fmu.variables[name])})"
        for name, value in numbers.items()
        if _is_beyond(case.fmu.variables[name], value, value)
    ]
    if held:
        yield Finding(
            "fixed values inside the FMU's min and max",
            "warn",
            f"beyond what the FMU allows: {_listed(held)}",
            "correct them under [fixed]; tools differ in what they do beyond",
        )
    odd = [
        f"{variable.name} = {value:g} K"
        for variable, value in zip(variables, convert(base_point(space)), strict=True)
        if value < COLDEST_K and _is_temperature(variable)
    ]
    if odd:
        yield Finding(
            "temperatures among the parameters",
            "warn",
            f"the FMU says kelvin: {_listed(odd)}",
            "see whether its equations count in degC, or the estimate does",
        )


def _is_beyond(variable: FmuVariable, lower: float, upper: float) -> bool:
    low, high = variable.minimum, variable.maximum
    return (low is not None and lower < low) or (high is not None and upper > high)


def _ends(variable: FmuVariable) -> str:
    ends = (variable.minimum, variable.maximum)
    return " to ".join("..." if end is None else f"{end:g}" for end in ends)


def base_point(space: ParameterSpace) -> FloatArray:
    """Return the estimates, the middle of the bounds where there is none. Shape (p,). [per parameter]."""
    middle = space.from_unit(np.full(space.n_parameters, 0.5))
    estimates = [parameter.estimate for parameter in space.parameters]
    return np.array([m if e is None else e for e, m in zip(estimates, middle, strict=True)])


def _is_temperature(variable: FmuVariable) -> bool:
    text = f"{variable.name} {variable.description}"
    is_difference = re.search(r"differ|delta|gradient|\bd[tT]|hyster|dead|band", text) is not None
    return variable.unit == "K" and not is_difference and re.search(r"(^|\.)T|[Tt]emp", text) is not None


def _data_in_wrong_unit(case: Case, inputs: dict[str, FloatArray]) -> Iterator[Finding]:
    doubts = []
    for name, values in inputs.items():
        doubt = temperature_doubt(values[values >= _usual(values)[0]], case.fmu.variables[name].unit)
        doubts += [f"{name}: {doubt}"] if doubt else []
    for output, samples in zip(case.outputs, case.measurement.samples, strict=True):
        doubt = temperature_doubt(samples.values[~_is_far(samples.values)], output.unit)
        doubts += [f"measured {output.name}: {doubt}"] if doubt else []
    if doubts:
        yield Finding(
            "units of the data",
            "warn",
            "; ".join(doubts[:LONGEST]),
            "look into the CSV file and correct unit in the case file (K and degC are converted)",
        )


def _listed(names: list[str]) -> str:
    return ", ".join(names[:LONGEST]) + (f" and {len(names) - LONGEST} more" if len(names) > LONGEST else "")
