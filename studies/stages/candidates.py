"""Experiments that might be made next: recordings, windows, courses of an input, another output."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.case import Case, load_case
from simulation.case_parts import conversions
from simulation.case_reading import read_experiments
from simulation.errors import InputError
from simulation.foreign_text import toml_text
from simulation.layout import MARK
from simulation.other_inputs import settings_with_inputs
from simulation.time_unit import DAY_S
from studies.task import Task

MOST_WINDOWS = 24
"""Windows of a recording that are compared."""

DWELLS = (0.025, 0.1)
"""Shortest times between two changes of a random binary course, as shares of the window."""

NIGHT_H = (22.0, 6.0)
"""From when until when a night course has the lower value. [h]"""


@dataclass(frozen=True, eq=False)
class Offer:
    """An experiment that might be made.

    Attributes:
        name: Its name.
        what: What it is, in words.
        case: Its model and what is measured; the samples mean nothing.
        columns: Its parameters among those of all. Shape (q,).
        is_own: Of which of all parameters it has a value of its own. Shape (p,).
        begins_anew: Whether it begins at another time than the present recording.
        block: Keys of its [[experiments]] table; a comment where it needs no table.
        course: Name of an input that it needs, with times [s] and values, shape (m, 2); None for none.
    """

    name: str
    what: str
    case: Case
    columns: IntArray
    is_own: BoolArray
    begins_anew: bool
    block: str
    course: tuple[str, FloatArray] | None = None

    @property
    def days(self) -> float:
        """How long the reported part takes. [d]."""
        time = self.case.scenario.time
        return float(time[-1] - time[0]) / DAY_S


def offers(
    task: Task, inputs: Sequence[Path], vary: Sequence[str], outputs: Sequence[str]
) -> tuple[Offer, list[Offer]]:
    """Return the present experiment, by which others are made, and all that might be made.

    Without anything named these are other windows of the recording, or the experiments that are held out.

    Args:
        task: The study.
        inputs: Recordings of inputs, files or folders.
        vary: Inputs that may be set, as NAME=LOW:HIGH in the unit of the case file.
        outputs: Outputs that might be measured, as NAME=UNCERTAINTY in the FMU's unit.

    Raises:
        InputError: A name or a value is wrong, or there is nothing to choose from.
    """
    present = _present(task.case)
    found = [_of_recording(present, file) for file in inputs]
    found += [one for text in vary for one in _of_input(present, text, task.profile.seed)]
    found += [_of_output(present, text) for text in outputs]
    if not found:
        found = [*(_held_out(task.case) if task.case.experiments else _windows(present))]
    if not found:
        raise InputError(
            f"{task.case.path}: no other window and no held-out experiment; give --inputs FILE, "
            "--vary INPUT=LOW:HIGH or --output NAME=UNCERTAINTY"
        )
    names = [one.name for one in found]
    if twice := next((name for name in names if names.count(name) > 1), ""):
        raise InputError(f"two candidates are called {twice}; give files of other names")
    return present, found


def _present(case: Case) -> Offer:
    """Return the present experiment, the first one of several."""
    names = case.parameter_space.names
    if not case.members:
        none = np.zeros(len(names), dtype=np.bool_)
        return Offer("present", "present", case, np.arange(len(names)), none, False, "")
    part, single = case.members[0]
    is_own = np.array([MARK in name for name in names])
    return Offer(part.name, "present", single, part.parameters, is_own, False, "")


def _of_recording(present: Offer, file: Path) -> Offer:
    settings = settings_with_inputs(present.case, file)
    case = replace(present.case, settings=settings, scenario=settings.scenario)
    name = re.sub(r"[^A-Za-z0-9_-]", "-", file.stem)[:60] or "inputs"
    time = settings.scenario.time_communication
    whole = f"[{time[0] / DAY_S:.10g}, {time[-1] / DAY_S:.10g}]"
    block = (
        f'time = {{ window_d = {whole}, start_d = {time[0] / DAY_S:.10g} }}\ndata = "..."  # of {file.name}'
    )
    return replace(
        present, name=name, what=f"inputs of {file.name}", case=case, begins_anew=True, block=block
    )


def _windows(present: Offer) -> Iterator[Offer]:
    """Yield the windows of the recording that follow the present one, each as long."""
    case = present.case
    begin, end = case.window_d
    for n in range(1, MOST_WINDOWS + 1):
        window = begin + n * (end - begin), end + n * (end - begin)
        try:
            other = load_case(case.path, window_d=window)
        except InputError:
            # The recording ends.
            return
        starts = other.scenario.time_communication[0]
        is_same = bool(starts == case.scenario.time_communication[0])
        said = f"{window[0]:.10g}-{window[1]:.10g}"
        block = (
            f"time = {{ window_d = [{window[0]:.10g}, {window[1]:.10g}], start_d = {starts / DAY_S:.10g} }}"
        )
        yield replace(
            present, name=f"days-{said.replace('.', '_')}", what=f"days {said} of the recording",
            case=other, begins_anew=not is_same, block=block,
        )  # fmt: skip


def _held_out(case: Case) -> Iterator[Offer]:
    """Yield the experiments that are held out."""
    names, other = case.parameter_space.names, case.validation
    for part, single in () if other is None else other.members:
        of_all = [other.parameter_space.names[k] for k in part.parameters] if other else []
        columns = np.array([names.index(name) for name in of_all])
        none = np.zeros(len(names), dtype=np.bool_)
        what, how = (
            f"held-out experiment {part.name}",
            f"# Remove held_out = true of the experiment {part.name}.",
        )
        yield Offer(part.name, what, single, columns, none, False, how)


def _of_input(present: Offer, text: str, seed: int) -> Iterator[Offer]:
    """Yield courses of an input that may be set: a step, random binary ones, nights."""
    case = present.case
    file = next(one.file for one in read_experiments(case.path) if one.name == case.experiment)
    found = re.fullmatch(r"([^=]+)=([^:]+):([^:]+)", text)
    tables = [one.name for one in file.inputs]
    try:
        name, low, high = found[1], float(found[2]), float(found[3])  # type: ignore[index]
        place = tables.index(name)
    except (TypeError, ValueError):
        raise InputError(
            f"--vary {text}: write INPUT=LOW:HIGH in the unit of the case file; inputs: {', '.join(tables)}"
        ) from None
    if not low < high or file.inputs[place].column is None:
        raise InputError(f"--vary {text}: LOW has to be below HIGH, and {name} to be a column, not a sum")
    change = conversions(case.fmu, "input", file.inputs)[place]
    edges, rng = case.scenario.time_communication, np.random.default_rng(seed)
    share = (edges[:-1] - edges[0]) / (edges[-1] - edges[0])
    courses = {"step": (f"a step of {name} in the middle", share >= 0.5)}
    for dwell in DWELLS:
        drawn = rng.integers(0, 2, int(1.0 / dwell) + 1) == 1
        hours = dwell * (edges[-1] - edges[0]) / 3600.0
        what = f"random steps of {name}, {hours:.2g} h and longer"
        courses[f"random-{hours:.2g}h".replace(".", "_")] = (what, drawn[(share / dwell).astype(np.int64)])
    if edges[-1] - edges[0] > DAY_S:
        hour = edges[:-1] / 3600.0 % 24.0
        courses["nights"] = (f"nights of {name}", (hour >= NIGHT_H[1]) & (hour < NIGHT_H[0]))
    for kind, (what, is_high) in courses.items():
        values = np.where(is_high, high, low)
        inputs = case.scenario.inputs.copy()
        inputs[:, place] = values * change.factor + change.offset
        at_edges = case.scenario.inputs_at_edges
        if at_edges is not None:
            at_edges = at_edges.copy()
            at_edges[:, place] = np.concatenate([inputs[:1, place], inputs[:, place]])
        scenario = replace(case.scenario, inputs=inputs, inputs_at_edges=at_edges)
        label = re.sub(r"[^A-Za-z0-9_-]", "-", f"{name}-{kind}")
        named = toml_text(name)
        row = f'{{ name = {named}, file = "{label}.csv", column = {named}, interpolation = "held" }}'
        yield replace(
            present, name=label, what=what, begins_anew=True, block=f"inputs = [{row}]",
            case=replace(case, scenario=scenario, settings=replace(case.settings, scenario=scenario)),
            course=(name, np.column_stack([edges[:-1], values])),
        )  # fmt: skip


def _of_output(present: Offer, text: str) -> Offer:
    """Return the present experiment with another output measured beside."""
    case = present.case
    name, _, sensor = text.partition("=")
    try:
        uncertainty = float(sensor)
    except ValueError:
        uncertainty = 0.0
    if name not in case.fmu.variables or not 0.0 < uncertainty < np.inf:
        raise InputError(
            f"--output {text}: write NAME=UNCERTAINTY with a variable of {case.fmu.path.name} and the "
            "uncertainty of its sensor in the FMU's unit, such as TWall=0.1"
        )
    settings = replace(
        case.settings, output_names=(name,), output_offsets=np.zeros(1), output_factors=None, accepted=None
    )
    time = case.scenario.time
    measured = replace(
        case.outputs[0], name=name, unit=case.fmu.variables[name].unit, uncertainty=uncertainty, limits=None
    )
    measurement = replace(case.measurement, outputs=(measured,), time=time)
    other = replace(case, settings=settings, measurement=measurement)
    named = f"name = {toml_text(name)} and uncertainty = {uncertainty:g}"
    block = f"# Add [[outputs]] with {named}, in the unit of the FMU."
    label = re.sub(r"[^A-Za-z0-9_-]", "-", name)
    none = np.zeros_like(present.is_own)
    return replace(present, name=label, what=f"{name} measured too", case=other, is_own=none, block=block)
