"""What drives a model: its recorded inputs, the same in every simulation, as plain arrays."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Drive:
    """Inputs over the m communication steps of all experiments, one experiment after the other.

    Attributes:
        potentials: Inputs in the first output's unit. Shape (m, a). [first output's unit]
        sources: Other inputs, divided by their standard deviations. Shape (m, b). [1]
        pattern: Which pattern of the switches holds in each step. Shape (m,).
        patterns: Which switches are on in each pattern. Shape (r, w).
        step: Communication step in units of two output steps. [1]
        bounds: First steps of the experiments, and m. Shape (e + 1,).
        every: Communication steps from one output to the next, by experiment. Shape (e,).
        n_before: First outputs that are simulated and not reported. Shape (e,).
        columns: Where a trajectory holds each output of the model. Shape (e, k).
        is_alike: Which of the model's outputs have the first one's unit. Shape (k,).
        is_start: Parameters in the first output's unit: they may be states at the start. Shape (p,).
        start_ratio: Units of these in the first output's unit, 0 for others. Shape (p,).
        time_powers: Powers of time in the parameters' units, empty where units are not known. Shape (p,).
        source_powers: The same of the sources. Shape (b,).
    """

    potentials: Array
    sources: Array
    pattern: NDArray[np.int64]
    patterns: Array
    step: float
    bounds: NDArray[np.int64]
    every: NDArray[np.int64]
    n_before: NDArray[np.int64]
    columns: NDArray[np.int64]
    is_alike: NDArray[np.bool_]
    is_start: NDArray[np.bool_]
    start_ratio: Array
    time_powers: Array
    source_powers: Array

    @property
    def n_outputs(self) -> int:
        """Outputs of the model, in one experiment."""
        return int(self.columns.shape[1])

    def experiments(self) -> list[tuple[slice, NDArray[np.int64]]]:
        """Return the steps of each experiment, and which of the states around them are reported.

        The states around m steps are m + 1; the outputs of the last state see the last step's inputs.
        """
        found = []
        for place, (first, last) in enumerate(zip(self.bounds[:-1], self.bounds[1:], strict=True)):
            every = int(self.every[place])
            reported = np.arange(int(self.n_before[place]) * every, last - first + 1, every)
            found.append((slice(int(first), int(last)), reported))
        return found

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all as arrays by name, for a file."""
        return {field.name: np.asarray(getattr(self, field.name)) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Return what `to_arrays` was called on.

        Raises:
            KeyError: One is missing.
        """
        read: dict[str, Any] = {field.name: arrays[field.name] for field in fields(cls)}
        return cls(**(read | {"step": float(read["step"])}))
