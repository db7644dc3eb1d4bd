"""The text of a new case file: valid at once, commented, every line that needs the user marked EDIT."""

import json
import math
import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from simulation.fmi.description import FmuDescription
from simulation.fmi.variable import REAL_KINDS, FmuVariable
from simulation.time_unit import DAYS
from studies.new.choice import Bounds, Choice, Times, bounds_for

EDIT = "EDIT"
MOST_SHOWN = 40
"""Commented entries of one kind; the rest is given as a number, unless all are asked for."""
INPUTS_FILE, MEASURED_FILE = "inputs.csv", "measured.csv"
_TEMPERATURES = ("K", "degC", "°C")


@dataclass(frozen=True)
class NewCase:
    """Everything a new case file says.

    Attributes:
        name: Name of the case.
        place: What the user types to mean the case, quoted for a shell.
        fmu: The FMU.
        fmu_file: The FMU's file, from the case's folder.
        data: The folder of the recordings, from the case's folder.
        interface: How the FMU is run.
        inputs: The inputs that recordings drive.
        held_inputs: The inputs that are held at a value.
        outputs: The outputs.
        parameters: The parameters.
        fixable: Parameters that can be fixed but not calibrated.
        times: The time axis.
        show_all: Whether every variable is written, however many there are.
    """

    name: str
    place: str
    fmu: FmuDescription
    fmu_file: str
    data: str
    interface: str
    inputs: tuple[FmuVariable, ...]
    held_inputs: tuple[FmuVariable, ...]
    outputs: Choice
    parameters: Choice
    fixable: tuple[FmuVariable, ...]
    times: Times
    show_all: bool


def case_text(case: NewCase) -> str:
    """Return the case file."""
    parts = [_head(case), _time(case)]
    parts += [_input(variable) for variable in case.inputs]
    parts += [_output(variable) for variable in case.outputs.used]
    parts += _shown(case, case.outputs.others, "output", lambda v: _commented(_output(v)))
    parts += [_parameter(variable) for variable in case.parameters.used]
    parts += _shown(case, case.parameters.others, "parameter", lambda v: _commented(_parameter(v)))
    parts += [_fixed(case), _SIMULATION]
    return "\n\n".join(parts) + "\n"


def lines_to_edit(text: str) -> list[tuple[int, str]]:
    """Return number and content of the lines in use that are marked EDIT."""
    lines = enumerate(text.splitlines(), start=1)
    return [(number, line) for number, line in lines if f"# {EDIT}:" in line and not line.startswith("#")]


def toml_string(text: str) -> str:
    """Return a TOML string: its escapes are JSON's, and DEL is escaped as well."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def one_line(text: str) -> str:
    """Return a text that can stand in a comment: TOML allows no control character there."""
    return " ".join(re.sub(r"[\x00-\x1f\x7f]", " ", text).split())


def _head(case: NewCase) -> str:
    fmu = case.fmu
    tool = one_line(fmu.generation_tool) or "an unnamed tool"
    offered = ", ".join(fmu.interfaces)
    return f"""\
# What is calibrated, driven by what, compared with what. Written by `studies new` from what
# {fmu.path.name} says about itself ({one_line(fmu.model_name)}, FMI {fmu.fmi_version}, made by {tool}).
# Lines marked {EDIT} need you. Recordings are CSV files with a header line; their column time_s holds
# seconds, or their column time holds timestamps like 2024-03-01T13:30:00+01:00.
#   studies check {case.place}    says what is missing or wrong, one thing at a time, and what to do
#   studies calibrate {case.place}    calibrates
schema = 1
name = {toml_string(case.name)}
title = {toml_string(one_line(fmu.model_name) or case.name)}
note = ""                     # printed wherever the numbers appear, e.g. "measured in room 12, March 2024"
fmu = {toml_string(case.fmu_file)}
interface = {toml_string(case.interface)}   # the FMU offers: {offered}
data = {toml_string(case.data)}   # the folder of the CSV files, from here
data_origin = {toml_string("save yours there: README.md beside it says how")}
# time_column = "Zeit [s]"    # where the times stand, if not in time_s (seconds) or time (ISO 8601)
# timezone = "Europe/Berlin"  # of timestamps without an offset; else their clock is never set forward or back
# relative_tolerance = 1e-6   # of the FMU's solver; else the FMU's own"""


def _time(case: NewCase) -> str:
    times = case.times
    unit = times.unit
    stop, words, key = times.stop_s / unit.seconds, "days" if unit is DAYS else "seconds", unit.symbol
    other = "window_s and the like count seconds" if unit is DAYS else "window_d and the like count days"
    return f"""\
[time]   # {times.why}; {other}
window_{key} = [0, {_number(stop)}]   # {EDIT}: the part of the recording to calibrate with, in {
        words
    } since its first row
# start_{key} = 0                 # simulate from here, compare in the window only (a warm-up)
# shared_warmup = true        # simulate the warm-up once, with the estimates, if the FMU can save its state
# validation_{key} = [{_number(stop)}, {
        _number(2.0 * stop)
    }]   # a part that the calibration does not see, to try its result on
# zero = "2024-01-01"         # for timestamps: the model's time 0 and day 0; else the first row
communication_step_s = {
        _number(times.communication_step_s)
    }   # an input is constant over it; `studies check` halves it and says what changes
output_step_s = {_number(times.output_step_s)}   # {
        EDIT
    }: as your measurement is sampled; a multiple of the step above"""


def _input(variable: FmuVariable) -> str:
    column = "its unit in the CSV"
    unit, between = (
        _unit(variable.unit, column),
        'linear"   # held: switches, setpoints; linear or smooth: weather',
    )
    if variable.kind not in REAL_KINDS:
        unit = toml_string(variable.unit or "1")
        between = f'held"   # its values are {_values(variable)}; or hold it at one of them, under [fixed]'
    return f"""\
[[inputs]]   {_told(variable)}
name = {toml_string(variable.name)}
file = "{INPUTS_FILE}"
column = {toml_string(variable.name)}
unit = {unit}
interpolation = "{between}
# With held values, an output at the very moment of a jump still sees the value before it.
# max_gap_s = 7200            # bridge gaps up to this long; else a gap is an error"""


def _values(variable: FmuVariable) -> str:
    """Say which values a variable has that is no real number."""
    if variable.kind == "Boolean":
        return "0 and 1"
    items = ", ".join(f"{number} ({one_line(item)})" for item, number in variable.items.items())
    return items or "whole numbers"


def _output(variable: FmuVariable) -> str:
    temperature = variable.unit in _TEMPERATURES
    uncertainty = "0.5" if temperature else "1.0"
    chosen = f"   # {EDIT}: the variable that was measured; the FMU declares no output" * (
        variable.causality == "local"
    )
    return f"""\
[[outputs]]   {_told(variable)}
name = {toml_string(variable.name)}{chosen}
file = "{MEASURED_FILE}"
column = {toml_string(variable.name)}
unit = {_unit(variable.unit, "its unit in the CSV")}
uncertainty = {uncertainty}   # {EDIT}: how far the sensor may be off, in this unit
# error_lasts_s = 3600        # how long its error lasts, which priors are weighed by
# weight = 1                  # share of the error that this output has, relative to the others
# accepted = [0, 100]         # a simulation that leaves this band has failed"""


def _parameter(variable: FmuVariable) -> str:
    bounds = bounds_for(variable)
    estimate = variable.start if variable.start is not None else (bounds.lower + bounds.upper) / 2.0
    unit = toml_string(variable.unit or "1")
    is_log, range_width = bounds.scale == "log", bounds.upper - bounds.lower
    width = "within_factor = 1.5" if is_log else f"within = {_number(0.1 * range_width)}"
    lines = [
        f"[[parameters]]   {_declared(variable)}".rstrip(),
        f"name = {toml_string(variable.name)}",
        f"estimate = {_number(estimate)}   # the FMU's start value"
        if variable.start is not None
        else f"# estimate = {_number(estimate)}",
        f"lower = {_number(bounds.lower)}   # {_bounds_note(bounds)}",
        f"upper = {_number(bounds.upper)}",
        f"unit = {unit}",
        f'scale = "{bounds.scale}"',
        f"# prior = {{ about = {_number(estimate)}, {width} }}   # what is known of it, two thirds surely",
    ]
    if variable.description:
        lines.append(f"description = {toml_string(one_line(variable.description))}")
    return "\n".join(lines)


def _bounds_note(bounds: Bounds) -> str:
    if bounds.is_guess:
        return f"{EDIT}: {bounds.why}"
    return f"{bounds.why}; set them so that the answer surely lies inside"


def _told(variable: FmuVariable) -> str:
    return f"# {one_line(variable.description)}" if variable.description else "#"


def _declared(variable: FmuVariable) -> str:
    """Say the bounds that the FMU declares, as a comment."""
    said = [
        f"{word} {value:g}"
        for word, value in (("min", variable.minimum), ("max", variable.maximum))
        if value is not None and math.isfinite(value)
    ]
    words = [f"the FMU's {', '.join(said)}"] if said else []
    words += ["a start value"] if variable.is_start_value else []
    return f"# {'; '.join(words)}" if words else ""


def _unit(unit: str, whose: str) -> str:
    if not unit:
        return f""""1"   # {EDIT}: {whose}; the FMU declares none, so nothing is converted,
# fmu_unit = "W"              # unless you say here what the FMU's equations count in"""
    if unit in _TEMPERATURES:
        return f"{toml_string(unit)}   # {EDIT}: {whose}: K or degC, converted"
    return f"{toml_string(unit)}   # {whose}; another of the same kind is converted"


def _fixed(case: NewCase) -> str:
    lines = [
        "[fixed]   # parameters held at a value, in the FMU's units; all others keep the FMU's start value",
        '# TStart = { first_measured = "<output>" }   # e.g. a start value from the first measured one',
        '# TWall = { value = 7, unit = "degC" }       # or in another unit',
    ]
    lines += [
        f"{_key(variable.name)} = {_start(variable)}   # {EDIT}: a {variable.kind} input is held, as "
        f"only numbers follow a recording. {one_line(variable.description)}".rstrip()
        for variable in case.held_inputs
    ]
    shown, n_hidden = _limited(case, case.fixable)
    for variable in shown:
        meaning = one_line(f"{variable.kind} {variable.description}")
        lines.append(f"# {_key(variable.name)} = {_start(variable)}   # {meaning}")
    file = shlex.quote(case.fmu.path.name)
    lines += [f"# ... and {n_hidden} more: studies new {file} --list"] * bool(n_hidden)
    return "\n".join(lines)


_SIMULATION = """\
[simulation]   # patience; nothing here changes a result
# timeout_s = 60              # a simulation that takes longer is killed and has failed; without this line:
#                             # 100 times the slowest so far, at least 60 s, the first ones a day; inf: never
# retries = 1                 # how often one is tried again whose process crashed
# max_failed_share = 0.5      # stop when of 20 or more finished simulations a larger share has failed
# max_workers = 2             # as many at once as there are licences"""


def _start(variable: FmuVariable) -> str:
    """Return a start value that is no real number, as TOML."""
    text = variable.start_text
    if variable.kind == "Boolean":
        return "true" if text.strip().lower() in ("true", "1") else "false"
    return toml_string(text) if variable.kind == "String" else text or "0"


def _shown(
    case: NewCase, others: Sequence[FmuVariable], what: str, write: Callable[[FmuVariable], str]
) -> list[str]:
    shown, n_hidden = _limited(case, others)
    parts = []
    if shown:
        parts.append(f"# Further {what}s: remove the # of those to use.")
        parts += [write(variable) for variable in shown]
    if n_hidden:
        file = shlex.quote(case.fmu.path.name)
        parts.append(
            f"# ... and {n_hidden} more {what}s. See them: studies new {file} --list\n"
            f"# Have them used: --{what} NAME or a pattern; have all written here: --all"
        )
    return parts


def _limited(case: NewCase, variables: Sequence[FmuVariable]) -> tuple[Sequence[FmuVariable], int]:
    most = len(variables) if case.show_all else MOST_SHOWN
    return variables[:most], max(0, len(variables) - most)


def _commented(block: str) -> str:
    return "\n".join(f"# {line}" for line in block.splitlines())


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_string(name)


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) and abs(value) < 1e15 else repr(float(value))
