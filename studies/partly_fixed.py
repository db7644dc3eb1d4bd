"""A model of which some parameters are held at a value, so that a search sees the others alone."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories


class PartlyFixedModel(WrappedModel):
    """A model that is asked its free parameters and answers with the others at their fixed values."""

    def __init__(self, model: ForwardModel, fixed: Mapping[str, float]) -> None:
        """Wrap a model.

        Args:
            model: The model to ask.
            fixed: Values of the parameters that are held, by name. [per parameter]

        Raises:
            ValueError: If the model has no such parameter, or none would be left.
        """
        super().__init__(model)
        space = model.parameter_space
        unknown = [name for name in fixed if name not in space.names]
        if unknown:
            raise ValueError(f"the model has no parameter {unknown[0]}; it has {', '.join(space.names)}")
        self._space = space.without(fixed)
        self._is_free = np.array([name not in fixed for name in space.names])
        self._values = np.array([fixed.get(name, np.nan) for name in space.names], dtype=np.float64)

    @property
    def parameter_space(self) -> ParameterSpace:
        """The free parameters."""
        return self._space

    def complete(self, theta: FloatArray) -> FloatArray:
        """Return rows of free parameters with the fixed ones in their places.

        Args:
            theta: Free parameters. Shape (n, k) or (k,). [per parameter]

        Returns:
            Shape (n, p) or (p,). [per parameter]
        """
        theta = np.asarray(theta, dtype=np.float64)
        full = np.broadcast_to(self._values, (*theta.shape[:-1], self._values.size)).copy()
        full[..., self._is_free] = theta
        return full

    def reduced(self, theta: FloatArray) -> FloatArray:
        """Return the free parameters of rows of all parameters.

        Args:
            theta: All parameters. Shape (n, p) or (p,). [per parameter]

        Returns:
            Shape (n, k) or (k,). [per parameter]
        """
        free: FloatArray = np.asarray(theta, dtype=np.float64)[..., self._is_free]
        return free

    def holds(self, theta: FloatArray) -> BoolArray:
        """Say which rows of all parameters have the fixed ones at exactly their values.

        Args:
            theta: All parameters. Shape (n, p). [per parameter]

        Returns:
            Shape (n,).
        """
        same: BoolArray = np.all((theta == self._values) | self._is_free, axis=1)
        return same

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate every row with the other parameters at their fixed values.

        Args:
            theta: Free parameters. Shape (n, k). [per parameter]

        Returns:
            The wrapped model's answer, its parameters the free ones.
        """
        return self.of_free(self._model.simulate(self.complete(theta)))

    def of_free(self, answer: Trajectories) -> Trajectories:
        """Return rows of the wrapped model with the free parameters alone."""
        return replace(answer, theta=self.reduced(answer.theta), parameter_names=self._space.names)
