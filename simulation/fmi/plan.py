"""What a run sets, steps through and reads, resolved from names to the FMU's references."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.description import FmuDescription
from simulation.fmi.variable import FmuVariable
from simulation.scenario import Scenario


@dataclass(frozen=True, eq=False)
class RunPlan:
    """What is the same for every row of a model.

    Attributes:
        calibrated: The parameters that differ from row to row, in the order of a row. Length p.
        fixed: The parameters held at a value, with their values. [FMU's units]
        input_variables: The inputs. Length n_inputs.
        inputs: Input of each step, constant over it. Shape (m, n_inputs). [FMU's units]
        output_references: Value references. Shape (k,), uint32.
        outputs: The outputs. Length k.
        edges: Edges of the communication steps. Shape (m + 1,). [s]
        output_every: Steps between two outputs.
        n_warmup: Outputs before those that are reported.
        tolerance: Relative tolerance to ask for, None for the FMU's own.
    """

    calibrated: tuple[FmuVariable, ...]
    fixed: tuple[tuple[FmuVariable, float | int | bool | str], ...]
    input_variables: tuple[FmuVariable, ...]
    inputs: FloatArray
    output_references: Any
    outputs: tuple[FmuVariable, ...]
    edges: FloatArray
    output_every: int
    n_warmup: int
    tolerance: float | None

    @property
    def n_steps(self) -> int:
        """Number of communication steps."""
        return len(self.edges) - 1

    @property
    def n_simulated(self) -> int:
        """Number of outputs of a row, the warm-up's included."""
        return self.n_steps // self.output_every + 1


def run_plan(
    description: FmuDescription,
    scenario: Scenario,
    *,
    calibrated: Sequence[str],
    fixed: Mapping[str, float | int | bool | str],
    outputs: Sequence[str],
    tolerance: float | None,
) -> RunPlan:
    """Find every variable in the FMU.

    Args:
        description: What the FMU says of itself.
        scenario: Inputs and times.
        calibrated: Names of the parameters that differ from row to row.
        fixed: Parameters held at a value.
        outputs: Names of the outputs.
        tolerance: Relative tolerance, None for the one that the FMU suggests.

    Returns:
        The plan.

    Raises:
        InputError: If the FMU does not have a variable, or has it as something else.
    """
    where = str(description.path)

    def found(names: Sequence[str], causality: str, *, may_be_input: bool = False) -> tuple[FmuVariable, ...]:
        return tuple(description.require(name, causality, where, may_be_input=may_be_input) for name in names)

    def references(variables: Sequence[FmuVariable]) -> Any:
        return np.array([variable.reference for variable in variables], dtype=np.uint32)

    output_variables = found(outputs, "output")
    input_variables = found(scenario.input_names, "input")
    return RunPlan(
        calibrated=found(calibrated, "parameter", may_be_input=True),
        fixed=tuple(
            (description.find(name, "parameter", where, may_be_input=True), value)
            for name, value in fixed.items()
        ),
        input_variables=input_variables,
        inputs=np.ascontiguousarray(scenario.inputs, dtype=np.float64),
        output_references=references(output_variables),
        outputs=output_variables,
        edges=np.ascontiguousarray(scenario.time_communication, dtype=np.float64),
        output_every=scenario.output_every,
        n_warmup=scenario.n_warmup,
        tolerance=tolerance if tolerance is not None else description.default_experiment.tolerance,
    )
