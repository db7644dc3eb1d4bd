"""What a run sets, steps through and reads, resolved from names to the FMU's references."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.fmi.variable import FmuVariable, Value


@dataclass(frozen=True, eq=False)
class RunPlan:
    """What is the same for every row of a model.

    Attributes:
        calibrated: The parameters that differ from row to row, in the order of a row. Length p.
        fixed: The parameters held at a value, with their values. [FMU's units]
        input_variables: The inputs. Length n_inputs.
        inputs: Input of each step, constant over it. Shape (m, n_inputs). [FMU's units]
        inputs_at_edges: Inputs that outputs see, None where these see their step's. Shape (m + 1, n_inputs).
            [FMU's units]
        output_references: Value references. Shape (k,), uint32.
        edges: Edges of the communication steps. Shape (m + 1,). [s]
        output_every: Steps between two outputs.
        n_warmup: Outputs before those that are reported.
        tolerance: Relative tolerance to ask for, None for the FMU's own.
    """

    calibrated: tuple[FmuVariable, ...]
    fixed: tuple[tuple[FmuVariable, Value], ...]
    input_variables: tuple[FmuVariable, ...]
    inputs: FloatArray
    inputs_at_edges: FloatArray | None
    output_references: Any
    edges: FloatArray
    output_every: int
    n_warmup: int
    tolerance: float | None

    @property
    def n_steps(self) -> int:
        """Number of communication steps."""
        return len(self.edges) - 1

    def empty_y(self) -> FloatArray:
        """Return an array for the outputs of a row, the warm-up's included. Shape (n_simulated, k)."""
        return np.empty((self.n_steps // self.output_every + 1, len(self.output_references)))
