"""The plug between physics and learning: parameters in, trajectories out, always a batch."""

from typing import Protocol, runtime_checkable

from simulation.arrays import FloatArray
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories


@runtime_checkable
class ForwardModel(Protocol):
    """Anything that answers parameter rows with trajectories.

    Promises of every implementation: the row order is kept; rows are independent of each other; the same
    row gives the same answer at any time; a bad row does not raise, it is NaN throughout and says why. A row
    that only another process can answer raises NeedsFreshProcess, unless the model has such processes.
    Bounds are not enforced: they belong to what chooses the rows.
    """

    @property
    def parameter_space(self) -> ParameterSpace:
        """The parameters, in the order of the columns of theta."""
        ...

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the k outputs."""
        ...

    @property
    def time(self) -> FloatArray:
        """Output times. Shape (t,). [s]."""
        ...

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The trajectories, one per row, in the order of the rows.
        """
        ...


class WrappedModel:
    """What a model around another model passes on; a subclass says what simulating means."""

    def __init__(self, model: ForwardModel) -> None:
        """Wrap a model.

        Args:
            model: The model to ask.
        """
        self._model = model

    @property
    def parameter_space(self) -> ParameterSpace:
        """The wrapped model's parameters."""
        return self._model.parameter_space

    @property
    def output_names(self) -> tuple[str, ...]:
        """The wrapped model's outputs."""
        return self._model.output_names

    @property
    def time(self) -> FloatArray:
        """The wrapped model's output times. Shape (t,). [s]."""
        return self._model.time
