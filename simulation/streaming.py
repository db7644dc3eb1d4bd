"""Answers chunk by chunk as they finish, for batches that memory should not hold."""

from collections.abc import Callable, Generator
from typing import Final, Protocol, runtime_checkable

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.forward_model import ForwardModel
from simulation.trajectories import Trajectories

BLOCK_ROWS: Final = 64
OnRows = Callable[[int], None]
"""Called with the number of rows finished so far."""


@runtime_checkable
class PoolingModel(Protocol):
    """A model that hands over its answers as they finish, in any order."""

    def as_finished(self, theta: FloatArray) -> Generator[tuple[IntArray, Trajectories]]:
        """Simulate every row.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Yields:
            Which rows have finished, and their trajectories. Shape (m,).
        """
        ...


def as_finished(model: ForwardModel, theta: FloatArray) -> Generator[tuple[IntArray, Trajectories]]:
    """Simulate every row and yield chunks as they finish, also of a model that simulates one after the other.

    Args:
        model: The model to ask.
        theta: Parameters. Shape (n, p). [per parameter]

    Yields:
        Which rows have finished, and their trajectories. Shape (m,).
    """
    if isinstance(model, PoolingModel):
        yield from model.as_finished(theta)
        return
    for start in range(0, len(theta), BLOCK_ROWS):
        rows = np.arange(start, min(start + BLOCK_ROWS, len(theta)), dtype=np.int64)
        yield rows, model.simulate(theta[rows])
