"""What a new case takes from an FMU's description: variables, bounds, interface, steps, and why."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from typing import Literal

from simulation.errors import InputError
from simulation.fmi.description import FmuDescription
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.parameters import Scale
from simulation.time_unit import DAY_S, DAYS, SECONDS, TimeUnit

MOST_ACTIVE = 20
"""Parameters that a new case calibrates unless the user names them."""
FACTOR = 5.0
"""Bounds around a start value: a fifth and five times, as in the paper's study."""
TEMPERATURE_SPAN_K = 10.0
WIDEST_TEMPERATURE_K = 100.0
WIDEST_RATIO, WIDEST_SHIFT = 1e3, 1e2
"""The FMU's own bounds are taken when they are this near to each other, as a ratio or in start values."""
N_STEPS = 500
"""Communication steps of a new case whose FMU names no step."""

_OF_A_SOLVER = re.compile(
    r"(^|\.)(cpu_?time|event_?counter|solver(_\w+)?|integrator(_\w+)?|log_?level"
    r"|((rel|abs)(ative|olute)?_?|solver_?)tol(erance)?|(min|max|initial|solver)_?step_?(size)?)(\.|$)",
    re.IGNORECASE,
)


@dataclass(frozen=True)
class Bounds:
    """A box for one parameter, and where it comes from.

    Attributes:
        lower: Lower bound. [parameter's unit]
        upper: Upper bound. [parameter's unit]
        scale: Coordinates.
        why: Where the bounds come from.
        is_guess: Whether nothing in the FMU supports them.
    """

    lower: float
    upper: float
    scale: Scale
    why: str
    is_guess: bool = False


@dataclass(frozen=True)
class Choice:
    """Variables of one kind, split into those that the case uses and those it only shows.

    Attributes:
        used: In the case.
        others: Written as comments.
    """

    used: tuple[FmuVariable, ...]
    others: tuple[FmuVariable, ...]


@dataclass(frozen=True)
class Times:
    """A first time axis.

    Attributes:
        start_s: Begin of the window. [s]
        stop_s: End of the window. [s]
        step_s: Step over which inputs are constant, and of the outputs. [s]
        why: Where they come from.
    """

    start_s: float
    stop_s: float
    step_s: float
    why: str

    @property
    def unit(self) -> TimeUnit:
        """Unit of the window: days from a day on."""
        return DAYS if self.stop_s >= DAY_S else SECONDS


def parameter_candidates(fmu: FmuDescription) -> list[FmuVariable]:
    """Return what can be calibrated: real parameters, then start values."""
    parameters = [v for v in _of(fmu, "parameter") if _is_number(v)]
    return [*parameters, *(v for v in fmu.variables.values() if v.is_start_value and _is_number(v))]


def choose_parameters(fmu: FmuDescription, patterns: Sequence[str]) -> Choice:
    """Choose what to calibrate.

    Args:
        fmu: The FMU.
        patterns: Names, or globs like "wall.*"; empty for the first parameters at the top level whose start
            values show their order of magnitude. One that matches no parameter may match inputs.
    """
    candidates, inputs = parameter_candidates(fmu), [v for v in inputs_of(fmu) if _is_number(v)]
    if not candidates and not (patterns and inputs):
        raise InputError(
            f"{fmu.path}: has no real parameter that can be set; export it with parameters that are neither "
            "constant nor evaluated"
        )
    if patterns:
        return _matching(fmu, candidates, patterns, "parameter", beside=inputs)
    plain = [v for v in candidates if not (v.is_start_value or is_internal(v)) and not bounds_for(v).is_guess]
    top = [v for v in plain if "." not in v.name] or plain or candidates
    shown = [v for v in candidates if not is_internal(v)] or candidates
    return _split(shown, top[:MOST_ACTIVE])


def choose_outputs(fmu: FmuDescription, patterns: Sequence[str]) -> Choice:
    """Choose what is compared with a measurement: the named outputs, or the first one.

    An FMU without outputs offers its local variables. A pattern that matches no output may match these.

    Args:
        fmu: The FMU.
        patterns: Names or globs.
    """
    outputs = [v for v in _of(fmu, "output") if _is_number(v)]
    # Local variables can be read as well, where one is asked for or there is nothing else.
    local = [v for v in _of(fmu, "local") if _is_number(v) and not is_internal(v) and v.name[:4] != "der("]
    candidates = [v for v in outputs if not is_internal(v)] or outputs or local
    if not candidates:
        raise InputError(f"{fmu.path}: has no real output; export it with the measured variables as outputs")
    if patterns:
        return _matching(fmu, outputs or local, patterns, "output", beside=local)
    return _split(candidates, candidates[:1])


def inputs_of(fmu: FmuDescription, *, held: bool = False) -> tuple[FmuVariable, ...]:
    """Return the inputs that recordings drive: numbers and switches; or the texts, held at a value."""
    inputs = [v for v in _of(fmu, "input") if not v.is_out_of_reach]
    return tuple(v for v in inputs if (v.kind == "String") == held)


def other_parameters(fmu: FmuDescription) -> tuple[FmuVariable, ...]:
    """Return the parameters that are no numbers with a fraction: they can be fixed, not calibrated."""
    found = [*_of(fmu, "parameter"), *_of(fmu, "structuralParameter")]
    return tuple(v for v in found if v.kind not in REAL_KINDS and not v.shape and not is_internal(v))


def is_internal(variable: FmuVariable) -> bool:
    """Say whether a variable belongs to the tool or its solver, as `_cs_rel_tol` and `CPUtime` do."""
    name = variable.name
    return name.startswith(("_", "$")) or "._" in name or _OF_A_SOLVER.search(name) is not None


def bounds_for(variable: FmuVariable) -> Bounds:
    """Propose bounds: the FMU's own where they narrow something down, else a range around the start value."""
    start, low, high = variable.start, variable.minimum, variable.maximum
    if start is None:
        return Bounds(0.0, 1.0, "linear", "the FMU gives no start value: write what is plausible", True)
    if (low is not None and start < low) or (high is not None and start > high):
        low = high = None
    if low is not None and high is not None and _is_near(variable, low, high):
        is_wide = low > 0.0 and high / low >= 10.0
        return Bounds(low, high, "log" if is_wide else "linear", "the FMU's min and max")
    if start == 0.0:
        return Bounds(-1.0, 1.0, "linear", "the start value is 0: write what is plausible", True)
    if _is_temperature(variable):
        lower, upper, why = start - TEMPERATURE_SPAN_K, start + TEMPERATURE_SPAN_K, "start value +- 10 K"
    else:
        lower, upper = sorted((start / FACTOR, start * FACTOR))
        why = "1/5 to 5 times the start value"
    lower, upper = float(f"{lower:.6g}"), float(f"{upper:.6g}")
    if low is not None and low > lower:
        lower, why = low, f"{why}, not below the FMU's min"
    if high is not None and high < upper:
        upper, why = high, f"{why}, not above the FMU's max"
    is_log = lower > 0.0 and not _is_temperature(variable)
    return Bounds(lower, upper, "log" if is_log else "linear", why)


def choose_times(fmu: FmuDescription) -> Times:
    """Take the default experiment for a first time axis."""
    experiment = fmu.default_experiment
    # No period of a case lies before time 0.
    start_s, stop_s, step = max(0.0, experiment.start_s or 0.0), experiment.stop_s, experiment.step_s
    span, why = DAY_S, "one day: the FMU names no default experiment"
    if stop_s is not None and stop_s > start_s:
        span, why = stop_s - start_s, "the FMU's default experiment"
    if step is None or not 0.0 < step <= span:
        step = _round_step(span / N_STEPS)
    n_steps = max(1, math.floor(span / step * (1.0 + 1e-9)))
    return Times(start_s, start_s + n_steps * step, step, why)


def _is_number(variable: FmuVariable) -> bool:
    return variable.kind in REAL_KINDS and not variable.shape


def _of(fmu: FmuDescription, causality: str) -> list[FmuVariable]:
    return [fmu.variables[name] for name in fmu.names(causality)]


def _matching(
    fmu: FmuDescription,
    candidates: list[FmuVariable],
    patterns: Sequence[str],
    what: Literal["parameter", "output"],
    *,
    beside: Sequence[FmuVariable],
) -> Choice:
    """Choose the candidates that patterns match; a pattern that matches none may match others beside."""
    used: dict[str, FmuVariable] = {}
    for pattern in patterns:
        # A name may hold brackets (wall[2].k), which a glob would read as a set of characters.
        glob = pattern.replace("[", "[[]")
        found = [v for v in (*candidates, *beside) if v.name == pattern][:1]
        found = found or [v for v in candidates if fnmatchcase(v.name, glob)]
        found = found or [v for v in beside if fnmatchcase(v.name, glob)]
        if not found:
            # A plain name that is missing or of another kind: the description knows what to say.
            if not set(pattern) & set("*?"):
                fmu.require(pattern, what, f"--{what} {pattern}")
            raise InputError(
                f"--{what} {pattern}: matches no {what} of {fmu.path.name}; "
                f"see them with: studies new {fmu.path} --list"
            )
        used |= {v.name: v for v in found}
    return _split(candidates, list(used.values()))


def _split(candidates: list[FmuVariable], used: list[FmuVariable]) -> Choice:
    names = {v.name for v in used}
    return Choice(tuple(used), tuple(v for v in candidates if v.name not in names))


def _is_near(variable: FmuVariable, low: float, high: float) -> bool:
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        return False
    if _is_temperature(variable):
        return high - low <= WIDEST_TEMPERATURE_K
    if low > 0.0:
        return high / low <= WIDEST_RATIO
    return high - low <= max(1.0, WIDEST_SHIFT * abs(variable.start or 0.0))


def _is_temperature(variable: FmuVariable) -> bool:
    unit = variable.unit.strip()
    start = variable.start or 0.0
    is_named = unit == "" and start < 400.0 and re.match(r"T(?![a-z])|[Tt]emp", variable.name) is not None
    return (start > 200.0 and (unit == "K" or is_named)) or unit in ("degC", "°C")


def _round_step(seconds: float) -> float:
    """Return the largest step of 1, 2 or 5 times a power of ten, or of whole minutes, that is not above."""
    if seconds >= 60.0:
        return max(step for step in (60.0, 300.0, 600.0, 900.0, 1800.0, 3600.0) if step <= seconds)
    power = 10.0 ** math.floor(math.log10(seconds))
    return max(m * power for m in (1.0, 2.0, 5.0) if m * power <= seconds * (1.0 + 1e-9))
