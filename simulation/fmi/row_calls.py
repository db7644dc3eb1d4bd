"""What a run sets and reads, and in which order: parameters are set, the FMU initializes itself."""

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.fmi.variable import FmiVersion, FmuVariable, Value
from simulation.scenario import Scenario


@dataclass(frozen=True, eq=False)
class RunPlan:
    """What is the same for every row of a model.

    Attributes:
        calibrated: The parameters that differ from row to row, in the order of a row. Length p.
        fixed: The parameters held at a value, with their values. [FMU's units]
        input_variables: The inputs. Length n_inputs.
        scenario: Inputs and times. [FMU's units]
        outputs: The outputs. Length k.
        tolerance: Relative tolerance to ask for, None for the FMU's own.
        time_unit_s: How long one unit of the FMU's own time is. [s]
    """

    calibrated: tuple[FmuVariable, ...]
    fixed: tuple[tuple[FmuVariable, Value], ...]
    input_variables: tuple[FmuVariable, ...]
    scenario: Scenario
    outputs: tuple[FmuVariable, ...]
    tolerance: float | None
    time_unit_s: float = 1.0

    @cached_property
    def _read(self) -> tuple[Any, IntArray | None, int]:
        """References of what is read, places of the outputs in it (None for all in order), and its length."""
        references, places, starts = with_arrays(self.outputs)
        is_all = np.array_equal(places, np.arange(len(starts)))
        return references, None if is_all else places, len(starts)

    @property
    def output_references(self) -> Any:
        """Value references of what is read, one of each array. Shape (n_references,), uint32."""
        return self._read[0]

    def outputs_of(self, y: FloatArray) -> FloatArray:
        """Return the outputs among all values that are read. Shapes (t, n_values) and (t, k)."""
        places = self._read[1]
        return y if places is None else y[:, places]

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
        """Return an array for what is read in a row, the warm-up included. Shape (n_simulated, n_values)."""
        return np.empty((self.n_steps // self.scenario.output_every + 1, self._read[2]))


def with_arrays(variables: Sequence[FmuVariable]) -> tuple[Any, IntArray, list[float]]:
    """Return what a function of FMI is called with for variables, some of which are elements of arrays.

    An array has one reference and all its values.

    Args:
        variables: The variables. Length n.

    Returns:
        Value references, uint32; where the value of each variable stands among all, shape (n,); and the start
        values of all, 0 of scalars.
    """
    begins, references, places, starts = dict[int, int](), list[int](), list[int](), list[float]()
    for one in variables:
        # Two scalars of one reference are two: the one is an alias of the other.
        begin = begins.get(one.reference) if one.array else None
        if begin is None:
            begin = begins[one.reference] = len(starts)
            references.append(one.reference)
            starts += one.array or (0.0,)
        places.append(begin + one.element)
    return np.array(references, dtype=np.uint32), np.array(places, dtype=np.int64), starts


class Setting:
    """Some variables that one function sets, and their values in its C type.

    Attributes:
        function: The function, without the version.
        columns: Which of the variables that were to be sorted they are. Shape (n,).
        references: Value references, one of each array. Shape (n_references,), uint32.
        values: All values, a row for each step; pointers to texts. Shape (m, n_values).
        places: Where the variables' values stand among them. Shape (n,).
        has_arrays: Whether some of the variables are elements of arrays.
        texts: The texts, of variables that are such.
        arguments: What follows the instance in a call that sets the first row.
    """

    def __init__(
        self,
        function: str,
        columns: list[int],
        variables: Sequence[FmuVariable],
        values: list[Any],
        held: Mapping[tuple[int, int], float],
    ) -> None:
        self.function = function
        self.columns = columns
        its = [variables[column] for column in columns]
        self.references, self.places, starts = with_arrays(its)
        self.has_arrays = any(one.array for one in its)
        chosen = [values[column] for column in columns]
        # Held here, as the FMU gets bare addresses.
        self.texts = [text.encode() for text in chosen if isinstance(text, str)]
        self._buffers = [ctypes.create_string_buffer(text) for text in self.texts]
        if self.texts:
            chosen = [np.array([ctypes.addressof(text)]) for text in self._buffers]
        self.values: Any = np.column_stack(chosen)
        if self.has_arrays:
            # An array is set as a whole.
            whole = np.tile(np.array(starts).astype(self.values.dtype), (len(self.values), 1))
            for one, place in zip(its, self.places, strict=True):
                for element in range(len(one.array)):
                    if (one.reference, element) in held:
                        whole[:, place - one.element + element] = held[one.reference, element]
            whole[:, self.places] = self.values
            self.values = whole
        # Addresses are reckoned once: a row may take no longer than a few of these calls.
        n, n_values = len(self.references), self.values.shape[1]
        self.arguments = (self.references.ctypes.data, n, self.values.ctypes.data, n_values)


def grouped(
    variables: Sequence[FmuVariable],
    values: list[Any],
    held: Mapping[tuple[int, int], float] | None = None,
) -> list[Setting]:
    """Sort variables by the functions that set them: one call per function, not per variable.

    Args:
        variables: The variables.
        values: Of each, its value or its values over the steps.
        held: Values of other elements of their arrays by reference and place, where not their start values.
    """
    groups: dict[str, list[int]] = {}
    for column, variable in enumerate(variables):
        groups.setdefault(variable.setter, []).append(column)
    return [Setting(name, columns, variables, values, held or {}) for name, columns in groups.items()]


class Experiment(NamedTuple):
    """Arguments of the functions that an FMU is given its time span by.

    Attributes:
        is_asked: Whether a tolerance is asked for.
        tolerance: The tolerance.
        start: Where the simulation begins. [FMU's unit of time]
        has_stop: Whether its end is given.
        stop: Its end. [FMU's unit of time]
    """

    is_asked: bool
    tolerance: float
    start: float
    has_stop: bool
    stop: float


class RowCalls:
    """What takes an instance from "as if just instantiated" to the first step.

    Attributes:
        parameters: The parameters that differ from row to row, by the functions that set them.
        inputs: The inputs, likewise, over the steps.
        calls: Functions without the version, in their order, each with what it is given.
    """

    def __init__(self, plan: RunPlan, version: FmiVersion) -> None:
        """Sort the parameters and the inputs by the functions that set them.

        Args:
            plan: What is to be set.
            version: FMI version of the FMU.
        """

        def fixed(is_structural: bool) -> list[Setting]:
            chosen = [v for v in plan.fixed if (v[0].causality == "structuralParameter") == is_structural]
            values = [v if isinstance(v, str) else np.array([v], one.dtype) for one, v in chosen]
            return grouped([one for one, _ in chosen], values)

        structural, others = fixed(True), fixed(False)
        held = {
            (one.reference, one.element): float(v)
            for one, v in plan.fixed
            if one.array and not isinstance(v, str)
        }
        zeros = [np.zeros(1, one.dtype) for one in plan.calibrated]
        self.parameters = grouped(plan.calibrated, zeros, held)
        driven = zip(plan.input_variables, plan.scenario.inputs.T, strict=True)
        self.inputs = grouped(plan.input_variables, [values.astype(one.dtype) for one, values in driven])
        start, stop = float(plan.edges[0]), float(plan.edges[-1])
        experiment = Experiment(plan.tolerance is not None, plan.tolerance or 0.0, start, True, stop)
        is_fmi2 = version == "2.0"

        def setting(settings: list[Setting]) -> list[tuple[str, Setting]]:
            return [(one.function, one) for one in settings]

        configuration = [
            ("EnterConfigurationMode", None),
            *setting(structural),
            ("ExitConfigurationMode", None),
        ]
        self.calls: list[tuple[str, Setting | Experiment | None]] = [
            # The standard wants structural parameters first, in a mode of their own: they may change sizes.
            *(configuration if structural else []),
            *([("SetupExperiment", experiment)] if is_fmi2 else []),
            *setting(others),
            *setting(self.parameters),
            # FMI 3.0 has no SetupExperiment and takes the same arguments here.
            ("EnterInitializationMode", None if is_fmi2 else experiment),
            # Inputs of the first step are set here too: initial values may depend on them.
            *setting(self.inputs),
            ("ExitInitializationMode", None),
        ]

    def fill(self, values: FloatArray) -> None:
        """Put the parameters of a row where the calls find them. Shape (p,). [FMU's units]."""
        for one in self.parameters:
            # In place: the prepared calls hold the address of this array.
            one.values[0, one.places] = values[one.columns]
