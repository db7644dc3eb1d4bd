"""Answers block by block, for batches that memory should not hold."""

from collections.abc import Callable, Generator, Iterator
from typing import Final, Protocol, runtime_checkable

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.forward_model import ForwardModel
from simulation.trajectories import Trajectories

BLOCK_ROWS: Final = 64
OnRows = Callable[[int], None]
"""Called with the number of rows finished so far."""


@runtime_checkable
class StreamingModel(Protocol):
    """A model that hands over its answers as they come."""

    def stream(self, theta: FloatArray, *, on_progress: OnRows | None = None) -> Iterator[Trajectories]:
        """Simulate every row.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]
            on_progress: Called with the number of rows finished so far.

        Yields:
            Consecutive blocks of rows, in order; a block may be overwritten when the next is asked for.
        """
        ...


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


def streamed(
    model: ForwardModel,
    theta: FloatArray,
    *,
    on_progress: OnRows | None = None,
    block_rows: int = BLOCK_ROWS,
) -> Generator[Trajectories]:
    """Simulate every row and yield consecutive blocks, also of a model that does not stream.

    Args:
        model: The model to ask.
        theta: Parameters. Shape (n, p). [per parameter]
        on_progress: Called with the number of rows finished so far.
        block_rows: Rows at a time that a model is asked for that does not stream.

    Yields:
        Blocks of rows, in order; a block may be overwritten when the next is asked for.
    """
    if isinstance(model, StreamingModel):
        yield from model.stream(theta, on_progress=on_progress)
        return
    for start in range(0, len(theta), block_rows):
        block = model.simulate(theta[start : start + block_rows])
        if on_progress is not None:
            on_progress(start + block.n)
        yield block
