"""What a run sets and reads, and the start of every row: parameters are set, the FMU initializes itself."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.instance import FmuInstance
from simulation.fmi.variable import REAL_KINDS, FmuVariable, Value
from simulation.scenario import Scenario


@dataclass(frozen=True, eq=False)
class RunPlan:
    """What is the same for every row of a model.

    Attributes:
        calibrated: The parameters that differ from row to row, in the order of a row. Length p.
        fixed: The parameters held at a value, with their values. [FMU's units]
        input_variables: The inputs. Length n_inputs.
        scenario: Inputs and times. [FMU's units]
        output_references: Value references. Shape (k,), uint32.
        tolerance: Relative tolerance to ask for, None for the FMU's own.
        time_unit_s: How long one unit of the FMU's own time is. [s]
    """

    calibrated: tuple[FmuVariable, ...]
    fixed: tuple[tuple[FmuVariable, Value], ...]
    input_variables: tuple[FmuVariable, ...]
    scenario: Scenario
    output_references: Any
    tolerance: float | None
    time_unit_s: float = 1.0

    @cached_property
    def edges(self) -> FloatArray:
        """Edges of the communication steps, contiguous. Shape (m + 1,). [FMU's unit of time]."""
        edges = np.ascontiguousarray(self.scenario.time_communication, dtype=np.float64)
        return edges if self.time_unit_s == 1.0 else edges / self.time_unit_s

    def in_seconds(self, time: float) -> float:
        """Convert a time of the FMU. [s]."""
        return time * self.time_unit_s

    @property
    def n_steps(self) -> int:
        """Number of communication steps."""
        return len(self.edges) - 1

    def empty_y(self) -> FloatArray:
        """Return an array for the outputs of a row, the warm-up's included. Shape (n_simulated, k)."""
        return np.empty((self.n_steps // self.scenario.output_every + 1, len(self.output_references)))


class Setting:
    """Some variables that one function sets, and their values in its C type.

    Attributes:
        function: The function, without the version.
        columns: Which of the variables that were to be sorted they are. Shape (n,).
        values: Their values, a row for each step; pointers to texts. Shape (m, n).
        arguments: What follows the instance in a call that sets the first row.
    """

    def __init__(
        self, function: str, columns: list[int], variables: Sequence[FmuVariable], values: list[Any]
    ) -> None:
        self.function = function
        self.columns = columns
        self._references = np.array([variables[column].reference for column in columns], dtype=np.uint32)
        chosen = [values[column] for column in columns]
        # Held here, as the FMU gets bare addresses.
        texts = [text.encode() for text in chosen if isinstance(text, str)]
        self._texts = [ctypes.create_string_buffer(text) for text in texts]
        if texts:
            chosen = [np.array([ctypes.addressof(text)]) for text in self._texts]
        self.values: Any = np.column_stack(chosen)
        # Addresses are reckoned once: a row may take no longer than a few of these calls.
        n = len(columns)
        self.arguments = (self._references.ctypes.data, n, self.values.ctypes.data, n)


class Start:
    """Sets the parameters of a row and initializes the instance; the same for all interfaces and versions.

    Attributes:
        inputs: The inputs, by the functions that set them.
        input_table: The same for the loops (see loop). Shape (n_functions, 5), intp.
        seen: The continuous inputs, by functions: over the m steps, then at the m + 1 edges; none where
            outputs see their step's inputs.
        seen_table: The same for the loops. Shape (n_functions, 5), intp.
    """

    def __init__(self, instance: FmuInstance, plan: RunPlan) -> None:
        """Sort the parameters and the inputs by the functions that set them.

        Args:
            instance: The FMU.
            plan: What is to be set.
        """
        self._instance = instance
        start, self._start_s = float(plan.edges[0]), plan.in_seconds(float(plan.edges[0]))

        def grouped(variables: Sequence[FmuVariable], values: list[Any]) -> list[Setting]:
            # One call per function, not per variable.
            groups: dict[str, list[int]] = {}
            for column, variable in enumerate(variables):
                groups.setdefault(variable.setter, []).append(column)
            return [Setting(name, columns, variables, values) for name, columns in groups.items()]

        def fixed(is_structural: bool) -> list[Setting]:
            chosen = [v for v in plan.fixed if (v[0].causality == "structuralParameter") == is_structural]
            values = [v if isinstance(v, str) else np.array([v], one.dtype) for one, v in chosen]
            return grouped([one for one, _ in chosen], values)

        structural, others = self._fixed = fixed(True), fixed(False)
        self._parameters = grouped(plan.calibrated, [np.zeros(1, one.dtype) for one in plan.calibrated])
        scenario = plan.scenario
        driven = zip(plan.input_variables, scenario.inputs.T, strict=True)
        self.inputs = grouped(plan.input_variables, [values.astype(one.dtype) for one, values in driven])
        self.input_table = _table(instance, self.inputs)
        at_edges = () if scenario.inputs_at_edges is None else scenario.inputs_at_edges.T
        continuous = [
            (variable, np.concatenate([over_steps, at]).astype(variable.dtype))
            for variable, over_steps, at in zip(
                plan.input_variables, scenario.inputs.T, at_edges, strict=False
            )
            # In continuous time no others may be set.
            if variable.kind in REAL_KINDS and variable.variability == "continuous"
        ]
        self.seen = grouped([one for one, _ in continuous], [values for _, values in continuous])
        self.seen_table = _table(instance, self.seen)
        asked, tolerance = plan.tolerance is not None, plan.tolerance or 0.0
        experiment = (asked, tolerance, start, True, float(plan.edges[-1]))
        is_fmi2 = instance.prefix == "fmi2"
        configuration = [("EnterConfigurationMode",), *_calls(structural), ("ExitConfigurationMode",)]
        self._calls = [
            # The standard wants structural parameters first, in a mode of their own: they may change sizes.
            *(configuration if structural else []),
            *([("SetupExperiment", *experiment)] if is_fmi2 else []),
            *_calls(others),
            *_calls(self._parameters),
            # FMI 3.0 has no SetupExperiment and takes the same arguments here.
            ("EnterInitializationMode", *(() if is_fmi2 else experiment)),
            # Inputs of the first step are set here too: initial values may depend on them.
            *_calls(self.inputs),
            ("ExitInitializationMode",),
        ]

    def begin(self, values: FloatArray) -> str:
        """Take the instance from "as if just instantiated" to the first step.

        Args:
            values: The calibrated parameters. Shape (p,). [FMU's units]

        Returns:
            Why it failed, in one line; "" when it did not.
        """
        for one in self._parameters:
            # In place: the prepared calls hold the address of this array.
            one.values[0] = values[one.columns]
        failure = self._instance.call_all(self._calls, self._start_s)
        self._instance.is_initialized = not failure
        return failure


def _table(instance: FmuInstance, settings: Sequence[Setting]) -> Any:
    """Return settings for the loops (see loop). Shape (n_functions, 5), intp."""
    calls = [(instance.addresses(s.function)[0], *s.arguments[:3], s.values.strides[0]) for s in settings]
    return np.array(calls, dtype=np.intp).reshape(-1, 5)


def _calls(settings: Sequence[Setting]) -> list[tuple[Any, ...]]:
    return [(one.function, *one.arguments) for one in settings]
