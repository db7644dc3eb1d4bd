"""Inputs of every type, laid out for the loops: one call for the inputs that one function sets."""

from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.fmi.instance import WARNING, FmuInstance
from simulation.fmi.kinds import SETTERS
from simulation.fmi.plan import RunPlan
from simulation.fmi.variable import REAL_KINDS, FmuVariable

# Columns of the table: what is called, with which references, how many, from which values on, and how many
# bytes further for the next step.
FUNCTION, REFERENCES, COUNT, VALUES, STRIDE = range(5)


class Inputs:
    """The inputs of a run by the functions that set them.

    Attributes:
        table: What the loops call before each step. Shape (n_functions, 5), intp.
    """

    def __init__(self, instance: FmuInstance, plan: RunPlan, where: str) -> None:
        """Convert the inputs to their C types.

        Args:
            instance: The FMU.
            plan: What the inputs are.
            where: The FMU's file, for messages.

        Raises:
            InputError: If a value is none of its type.
        """
        self._instance = instance
        self._kept: list[Any] = []
        self._names: list[str] = []
        setters = SETTERS[instance.prefix]
        groups: dict[str, list[int]] = {}
        for column, variable in enumerate(plan.input_variables):
            groups.setdefault(setters[variable.kind][0], []).append(column)
        self.table: Final = np.zeros((len(groups), 5), dtype=np.intp)
        for row, (name, columns) in enumerate(groups.items()):
            variables = [plan.input_variables[column] for column in columns]
            values = np.column_stack(
                [
                    _typed(variable, plan.inputs[:, column], plan.edges, where, setters[variable.kind][1])
                    for variable, column in zip(variables, columns, strict=True)
                ]
            )
            references = np.array([variable.reference for variable in variables], dtype=np.uint32)
            self._kept += [references, values]
            self._names.append(name)
            address, n = instance.addresses(name)[0], len(columns)
            self.table[row] = (
                address,
                references.ctypes.data,
                n,
                values.ctypes.data,
                values.strides[0],
            )

    def set_first(self, time: float) -> str:
        """Set the inputs of the first step.

        Args:
            time: Simulated time, for the message. [s]

        Returns:
            Why it failed, in one line; "" when it did not.
        """
        for name, (_, references, n, values, _) in zip(self._names, self.table.tolist(), strict=True):
            counts = (n, values) if self._instance.prefix == "fmi2" else (n, values, n)
            status = self._instance.call(name, references, *counts)
            if status > WARNING:
                return self._instance.failure(name, status, time)
        return ""

    def name(self, row: int) -> str:
        """Return the function of a row of the table, without the version."""
        return self._names[row]


def _typed(variable: FmuVariable, values: FloatArray, edges: FloatArray, where: str, dtype: Any) -> Any:
    """Return an input's values in its C type, contiguous. Shape (m,)."""
    if variable.kind in REAL_KINDS:
        return np.ascontiguousarray(values, dtype=dtype)
    low, high = (0, 1) if variable.kind == "Boolean" else (np.iinfo(dtype).min, np.iinfo(dtype).max)
    wrong = ~((values == np.rint(values)) & (values >= low) & (values <= high))
    if wrong.any():
        step = int(np.argmax(wrong))
        raise InputError(
            f"{where}: input {variable.name} is a {variable.kind} and gets {values[step]:g} at "
            f'{edges[step]:g} s; give whole numbers in its range, with interpolation = "held"'
        )
    return values.astype(dtype)
