"""Cases: a case file read, checked against its FMU and its recordings, and ready to be opened."""

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from simulation.arrays import FloatArray, IntArray, digest_of
from simulation.case_data import CaseData, on_one_axis, read_recordings
from simulation.case_file import CaseFile, InputTable, OutputTable
from simulation.case_meters import inputs_as_means, outputs_as_means
from simulation.case_parts import (
    check_inputs,
    constraints,
    conversions,
    fixed_values,
    input_values,
    ties,
    with_units,
)
from simulation.case_periods import Period, measured, plain_period, time_grid, validation_period
from simulation.case_reading import ReadExperiment, read_experiments
from simulation.errors import InputError, errors_at
from simulation.experiments import ExperimentRows, ExperimentsModel
from simulation.fmi.description import FmuDescription, read_description
from simulation.fmi.fmu import FmuModel, FmuSettings
from simulation.fmi.own_time import own_unit_s
from simulation.fmi.variable import Value
from simulation.foreign_text import shortened
from simulation.layout import MARK, Experiment, Layout, joined_measurement
from simulation.measurement import MeasuredOutput, Measurement
from simulation.named_files import NamedFiles, named_files
from simulation.parameters import Parameter, ParameterSpace, SumLimit
from simulation.pool.execution import ExecutionPolicy
from simulation.scenario import Scenario
from simulation.time_unit import DAY_S

_CHOSEN = ("relative_tolerance", "accepted", "parameter_factors", "parameter_offsets")
"""Settings that decide what a model answers; None is as usual."""


@dataclass(frozen=True)
class KnownError:
    """A mean squared error that is known for the case's window.

    Attributes:
        label: What reached it.
        mse: The error. [first output's unit squared]
        is_target: Whether results should say how many calls they needed to reach it.
    """

    label: str
    mse: float
    is_target: bool


@dataclass(frozen=True, eq=False)
class Case:
    """The physics of a study: which model, which parameters, driven by what, compared with what.

    Attributes:
        name: Short name, used in folders and labels.
        title: Title for reports.
        note: What must be said wherever the numbers appear, "" for nothing.
        path: The case file.
        fmu: What the FMU says about itself.
        parameter_space: Parameters to calibrate, in the units of the case file.
        scenario: Inputs from the start of the simulation to the end of the reported part.
        measurement: Measured outputs over the window.
        window_d: Compared part, in days of the case file. [d]
        communication_step_s: Step over which inputs are constant. [s]
        output_step_s: Step of the outputs. [s]
        settings: How the model is opened; plain data for worker processes.
        policy: How patiently simulations are run.
        said_units: Units of variables that the FMU declares none for, by name.
        references: Errors known for this window; they decide nothing.
        watched: Variables of the FMU that it answers beside the outputs, after them.
        validation: The same model compared over the validation period instead, None without one. Its
            simulations start as the case's do and go on; nothing of it decides what is calibrated. Where
            the case has experiments, those that are held out.
        experiments: The experiments that this case joins, none where it is a single one. Fields that one
            experiment alone can have are then the first one's.
        layout: How their rows become one, None without experiments.
        experiment: Name of the experiment that this case is of, "" where it is none of several.
    """

    name: str
    title: str
    note: str
    path: Path
    fmu: FmuDescription
    parameter_space: ParameterSpace
    scenario: Scenario
    measurement: Measurement
    window_d: tuple[float, float]
    communication_step_s: float
    output_step_s: float
    settings: FmuSettings
    policy: ExecutionPolicy = field(default_factory=ExecutionPolicy)
    said_units: Mapping[str, str] = field(default_factory=dict)
    references: tuple[KnownError, ...] = ()
    watched: tuple[str, ...] = ()
    validation: "Case | None" = None
    experiments: "tuple[Case, ...]" = ()
    layout: Layout | None = None
    experiment: str = ""

    @property
    def outputs(self) -> tuple[MeasuredOutput, ...]:
        """The outputs, with what was measured of them over the window."""
        return self.measurement.outputs

    @property
    def interface(self) -> str:
        """How the FMU is run."""
        return self.settings.interface

    @property
    def fixed(self) -> Mapping[str, Value]:
        """FMU parameters held at a value. [FMU's units]."""
        return self.settings.fixed

    @cached_property
    def named_files(self) -> NamedFiles:
        """The files that texts of the FMU name, which decide what it answers, as they are now."""
        return named_files(self.fmu, self.fixed)

    @cached_property
    def model_digest(self) -> str:
        """SHA-256 of all that decides what the model answers to a row: not of bounds, measurement or titles.

        What was simulated under one model digest holds for every case that has the same.
        """
        if self.layout is not None:
            return digest_of(self._joined("model_digest"))
        scenario = self.scenario
        grid = {"output_every": scenario.output_every, "n_warmup": scenario.n_warmup}
        return digest_of(_json(self._named | grid), scenario.time_communication, *scenario.driving)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that decides what the model answers in its box: not of titles or estimates."""
        space, scenario = self.parameter_space, self.scenario
        if self.layout is not None:
            return digest_of(self._joined("digest"), space.lower, space.upper)
        steps_s = (self.communication_step_s, self.output_step_s)
        kept: dict[str, Any] = {"constraints": space.constraints} if space.constraints else {}
        kept |= {"sums": space.sums} if space.sums else {}
        named = _json(self._named | {"window_d": self.window_d, "steps_s": steps_s} | kept)
        return digest_of(named, space.lower, space.upper, scenario.time_communication, *scenario.driving)

    def differs_in_values(self, other: "Case") -> bool:
        """Return whether another experiment differs in inputs' courses, times and fixed values at most."""

        def kind(case: Case) -> str:
            steps_s = (case.communication_step_s, case.output_step_s)
            return _json(case._named | {"fixed": sorted(case.fixed), "steps_s": steps_s})

        return kind(self) == kind(other) and self.parameter_space == other.parameter_space

    @property
    def _named(self) -> dict[str, Any]:
        """What decides answers and has a name; what the case leaves as usual is left out."""
        chosen = {name: getattr(self.settings, name) for name in _CHOSEN}
        chosen |= {"ties": [(one.name, one.expression) for one in self.settings.ties] or None}
        chosen |= {"time_unit_s": self.settings.time_unit_s if self.settings.time_unit_s != 1.0 else None}
        chosen |= {"files": sorted(self.named_files.digests.items()) or None}
        chosen |= {"watched": list(self.watched) or None, "said_units": dict(self.said_units) or None}
        return {
            "fmu": self.fmu.sha256,
            "interface": self.interface,
            "parameters": list(self.parameter_space.names),
            "fixed": sorted(self.fixed.items()),
            "inputs": list(self.scenario.input_names),
            "outputs": [(output.name, output.unit) for output in self.outputs],
        } | {name: value for name, value in chosen.items() if value is not None}

    def _joined(self, digest: str) -> str:
        """Return what decides the answers of all experiments."""
        return _json(
            {
                "parameters": self.parameter_space.names,
                "constraints": self.parameter_space.constraints,
                **({"sums": self.parameter_space.sums} if self.parameter_space.sums else {}),
                "experiments": [
                    (one.name, one.parameters.tolist(), getattr(case, digest)) for one, case in self.members
                ],
            }
        )

    @property
    def members(self) -> tuple[tuple[Experiment, "Case"], ...]:
        """The experiments that this case joins, each with its own case; none of a single one."""
        experiments = () if self.layout is None else self.layout.experiments
        return tuple(zip(experiments, self.experiments, strict=True))

    @property
    def experiment_rows(self) -> ExperimentRows:
        """Rows of any experiment, for one pool of processes; of a case with experiments."""
        assert self.layout is not None, "asked of a case with experiments"
        return ExperimentRows(self.layout, tuple(case.settings for case in self.experiments))

    @property
    def make_model(self) -> Callable[[], FmuModel | ExperimentsModel]:
        """A picklable factory of the model, to hand to worker processes."""
        return self.settings.open if self.layout is None else self.experiment_rows.open

    def open_model(self) -> FmuModel:
        """Open the model in this process.

        Returns:
            The model; close it, or use it in a `with` block.
        """
        return self.settings.open()


def load_case(
    path: Path | str,
    window_d: tuple[float, float] | None = None,
    communication_step_s: float | None = None,
) -> Case:
    """Read a case and check everything about it that can be checked without simulating.

    Args:
        path: The case file, or the folder that holds it as case.toml.
        window_d: Window to use instead of the file's; the validation period is left out where it overlaps or
            begins before it. [d]
        communication_step_s: Step to use instead of the file's, to see what it does. [s]

    Returns:
        The case.

    Raises:
        InputError: If anything in the file, the FMU or the recordings is missing, wrong or contradictory.
    """
    path = Path(path)
    if path.is_dir():
        path = path / "case.toml"
    read = read_experiments(path)
    if len(read) == 1 and not read[0].name:
        return _single(path, read[0].file, window_d, communication_step_s)
    cases = {}
    for one in read:
        with errors_at(f"{path}: experiments[{one.name}]"):
            if one.file.time.validation is not None:
                raise InputError("a validation period beside [[experiments]]; hold an experiment out instead")
            single = _single(path, one.file, None, communication_step_s)
            cases[one.name] = replace(single, experiment=one.name)
    with errors_at(path):
        case = _of_experiments(cases, read)
        if window_d is not None and window_d != case.window_d:
            raise InputError("its experiments have windows of their own; change these in the case file")
    return case


def named_experiments(case: Case) -> Iterator[tuple[str, Case]]:
    """Yield name and case of each experiment, those that are held out as well; none of a single one."""
    for joined in filter(None, (case, case.validation)):
        yield from ((one.name, member) for one, member in joined.members)


def of_experiment(case: Case, name: str | None, *, needed_for: str) -> tuple[Case, IntArray]:
    """Return the case of one experiment, and its parameters among those of all.

    Args:
        case: The case, with experiments or without.
        name: Name of the experiment; None where there is none to choose.
        needed_for: What asks, for messages.

    Raises:
        InputError: If the name is missing, or of no experiment.
    """
    joined = filter(None, (case, case.validation))
    known: dict[str | None, tuple[Case, IntArray]] = {
        part.name: (member, part.parameters) for one in joined for part, member in one.members
    }
    if not known:
        if name is not None:
            raise InputError(f"--experiment {name}: {case.path} has no [[experiments]]; leave it away")
        return case, np.arange(case.parameter_space.n_parameters)
    if name not in known:
        wrong = (
            f"--experiment {name}: no experiment of {case.path}"
            if name
            else f"{needed_for} needs --experiment"
        )
        raise InputError(f"{wrong}; name one of: {', '.join(map(str, known))}")
    return known[name]


def with_step(case: Case, step_s: float) -> Case:
    """Return the case of a single experiment with another communication step. [s]."""
    whole = load_case(case.path, None if case.experiment else case.window_d, communication_step_s=step_s)
    return next((one for name, one in named_experiments(whole) if name == case.experiment), whole)


def _single(
    path: Path, file: CaseFile, window_d: tuple[float, float] | None, communication_step_s: float | None
) -> Case:
    """Build the case of one experiment."""
    fmu = read_description(Path(os.path.realpath(path.parent / file.fmu)))
    fmu.interface(file.interface, str(path))
    recordings = read_recordings(path, file)
    with errors_at(path):
        fmu = with_units(fmu, _said_units(file))
        data = on_one_axis(file, recordings)
        file, data = outputs_as_means(inputs_as_means(file, fmu), fmu, data)
        plain = plain_period(file, window_d)
        stepped = file
        if communication_step_s is not None:
            step = {"communication_step_s": communication_step_s}
            stepped = file.model_copy(update={"time": file.time.model_copy(update=step)})
        case = _compared_over(path, stepped, fmu, data, plain)
        later = validation_period(file, plain, may_be_left_out=window_d is not None)
        if later is not None:
            # Errors of both periods are comparable: what normalizes outputs is that of the calibrated one.
            validation = _compared_over(path, stepped, fmu, data, later)
            pairs = zip(validation.measurement.outputs, case.measurement.outputs, strict=True)
            outputs = tuple(replace(one, weight=calibrated.weight) for one, calibrated in pairs)
            measurement = replace(validation.measurement, outputs=outputs)
            case = replace(case, validation=replace(validation, measurement=measurement))
    return case


def _of_experiments(cases: Mapping[str, Case], read: Sequence[ReadExperiment]) -> Case:
    """Join the cases of experiments; those that are held out validate the others."""
    calibrated = [one for one in read if not one.is_held_out]
    parameters, columns, places = list[Parameter](), dict[tuple[str, str], int](), dict[str, int]()
    shared = {name for one in calibrated for name in one.shared.values()}
    for one in read:
        for name in one.shared.values():
            if name in cases[one.name].fmu.variables:
                raise InputError(
                    f"experiments[{one.name}].shared: {shortened(name)} is a variable of the FMU; give what "
                    "is shared a name that it does not have"
                )
    for table in dict.fromkeys(name for one in read for name in cases[one.name].parameter_space.names):
        having = [one for one in read if table in cases[one.name].parameter_space.names]
        for one in having:
            name, own = one.shared.get(table), one.file.is_per_experiment(table)
            if one.is_held_out and (own if name is None else name not in shared):
                raise InputError(
                    f"parameters[{name or table}] has a value of its own in each experiment, and {one.name} "
                    f"is held out; give it one there: fixed = {{ {table} = ... }}"
                )
            name = name or (f"{table}{MARK}{one.name}" if own else table)
            if name not in places:
                places[name] = len(parameters)
                parameters.append(replace(_parameter(cases[one.name], table), name=name))
            columns[one.name, table] = places[name]
    pairs = dict.fromkeys(
        (parameters[columns[one.name, small]].name, parameters[columns[one.name, large]].name)
        for one in read
        for small, large in cases[one.name].parameter_space.constraints
    )
    sums = dict.fromkeys(
        SumLimit(
            tuple((parameters[columns[one.name, name]].name, weight) for name, weight in limit.terms),
            limit.most,
        )
        for one in read
        for limit in cases[one.name].parameter_space.sums
    )
    space = ParameterSpace(tuple(parameters), tuple(pairs), tuple(sums))
    case = _joined(space, cases, calibrated, columns)
    held_out = [one for one in read if one.is_held_out]
    return replace(case, validation=_joined(space, cases, held_out, columns)) if held_out else case


def _parameter(case: Case, name: str) -> Parameter:
    return case.parameter_space.parameters[case.parameter_space.names.index(name)]


def _joined(
    space: ParameterSpace,
    cases: Mapping[str, Case],
    read: Sequence[ReadExperiment],
    columns: Mapping[tuple[str, str], int],
) -> Case:
    """Join the cases of some experiments.

    Args:
        space: Parameters of all experiments.
        cases: The experiments' own cases by name.
        read: The experiments to join, in their order.
        columns: Place of every parameter among those of all, by experiment and name.
    """
    members = [cases[one.name] for one in read]
    first, steps_s = members[0], {one.output_step_s for one in members}
    if len(steps_s) > 1:
        steps = ", ".join(f"{step:g}" for step in sorted(steps_s))
        raise InputError(f"experiments have output steps of {steps} s; give all the same output_step_s")
    experiments, n_before = list[Experiment](), 0
    for one, case in zip(read, members, strict=True):
        own = [columns[one.name, name] for name in case.parameter_space.names]
        places = np.arange(n_before, n_before + len(case.outputs))
        n_times = len(case.measurement.time)
        experiments.append(Experiment(one.name, np.array(own, dtype=np.int64), places, n_times))
        n_before += len(case.outputs)
    measurement = joined_measurement([(one.name, cases[one.name].measurement, one.weight) for one in read])
    layout = Layout(space.names, measurement.output_names, measurement.time, tuple(experiments))
    return replace(
        first,
        parameter_space=space,
        measurement=measurement,
        window_d=(0.0, float(layout.time[-1]) / DAY_S),
        references=(),
        experiments=tuple(members),
        layout=layout,
        experiment="",
    )


def _said_units(file: CaseFile) -> dict[str, str]:
    tables: list[InputTable | OutputTable] = [*file.inputs, *file.outputs]
    return {one.name: one.fmu_unit for one in tables if one.fmu_unit is not None}


def _compared_over(path: Path, file: CaseFile, fmu: FmuDescription, data: CaseData, period: Period) -> Case:
    """Build the case whose measurement is that of a period."""
    space = ParameterSpace(tuple(table.to_parameter() for table in file.parameters), *constraints(file))
    parameters = conversions(fmu, "parameter", file.parameters)
    inputs = conversions(fmu, "input", file.inputs)
    check_inputs(file, fmu)
    outputs = [change.inverse for change in conversions(fmu, "output", file.outputs)]
    edges, output_every, n_warmup = time_grid(file, data, period)
    over_steps, at_edges = input_values(file, fmu, data, inputs, edges)
    scenario = Scenario(
        time_communication=edges,
        inputs=over_steps,
        inputs_at_edges=at_edges,
        input_names=tuple(table.name for table in file.inputs),
        output_every=output_every,
        n_warmup=n_warmup,
    )
    measurement = measured(file, data, scenario.time, period)
    bands = [table.accepted or (-np.inf, np.inf) for table in file.outputs]
    settings = FmuSettings(
        path=fmu.path,
        parameter_space=space,
        scenario=scenario,
        output_names=measurement.output_names,
        output_offsets=np.array([one.offset for one in outputs]),
        fixed=fixed_values(file, fmu, data, float(edges[0])),
        interface=file.interface,
        relative_tolerance=file.relative_tolerance,
        accepted=np.array(bands) if any(table.accepted for table in file.outputs) else None,
        output_factors=_unless(1.0, [one.factor for one in outputs]),
        parameter_factors=_unless(1.0, [one.factor for one in parameters]),
        parameter_offsets=_unless(0.0, [one.offset for one in parameters]),
        ties=ties(file, fmu),
        time_unit_s=own_unit_s(fmu.variables, fmu.units, file.time.fmu_unit, fmu.path.name),
    )
    return Case(
        name=file.name,
        title=file.title or file.name,
        note=file.note,
        path=path,
        fmu=fmu,
        parameter_space=space,
        scenario=scenario,
        measurement=measurement,
        window_d=period.compared_d,
        communication_step_s=file.time.communication_step_s,
        output_step_s=file.time.output_step_s,
        settings=settings,
        policy=ExecutionPolicy(**file.simulation.model_dump()),
        said_units=_said_units(file),
        references=tuple(
            KnownError(table.label, table.mse, table.target)
            for table in file.references
            if table.window == period.compared_d
        ),
    )


def _unless(usual: float, values: list[float]) -> FloatArray | None:
    """Return the values as an array, None where all are as usual."""
    return None if all(value == usual for value in values) else np.array(values)


def _json(content: dict[str, Any]) -> str:
    return json.dumps(content, sort_keys=True, default=np.ndarray.tolist)
