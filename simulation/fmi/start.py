"""The start of every row in this process: the calls of a row, made on an instance."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.instance import FmuInstance
from simulation.fmi.row_calls import RowCalls, RunPlan, Setting, grouped
from simulation.fmi.variable import REAL_KINDS


class Start:
    """Sets the parameters of a row and initializes the instance; the same for all interfaces and versions.

    Attributes:
        inputs: The inputs, by the functions that set them.
        input_table: The same for the loops (see loop). Shape (n_functions, 6), intp.
        seen: The continuous inputs, by functions: over the m steps, then at the m + 1 edges; none where
            outputs see their step's inputs.
        seen_table: The same for the loops. Shape (n_functions, 6), intp.
    """

    def __init__(self, instance: FmuInstance, plan: RunPlan) -> None:
        """Prepare the calls.

        Args:
            instance: The FMU.
            plan: What is to be set.
        """
        self._instance = instance
        self._start_s = plan.in_seconds(float(plan.edges[0]))
        self._row = RowCalls(plan, instance.version)
        self.inputs = self._row.inputs
        self.input_table = _table(instance, self.inputs)
        scenario = plan.scenario
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
        self._calls = [
            (name, *(one.arguments if isinstance(one, Setting) else one or ()))
            for name, one in self._row.calls
        ]

    def begin(self, values: FloatArray) -> str:
        """Take the instance from "as if just instantiated" to the first step.

        Args:
            values: The calibrated parameters. Shape (p,). [FMU's units]

        Returns:
            Why it failed, in one line; "" when it did not.
        """
        self._row.fill(values)
        failure = self._instance.call_all(self._calls, self._start_s)
        self._instance.is_initialized = not failure
        return failure


def _table(instance: FmuInstance, settings: Sequence[Setting]) -> Any:
    """Return settings for the loops (see loop). Shape (n_functions, 6), intp."""
    calls = [
        (instance.addresses(s.function)[0], *s.arguments[:3], s.values.strides[0], s.values.shape[1])
        for s in settings
    ]
    return np.array(calls, dtype=np.intp).reshape(-1, 6)
