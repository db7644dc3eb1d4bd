"""A model that answers by state equations: no simulation, next to no time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from simulation.layout import Layout
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.state_equations.coefficient import Points
from studies.calibration.state_equations.equations import StateEquations


@dataclass(frozen=True, eq=False)
class EquationModel:
    """What state equations answer in place of the model that they were learnt from.

    Attributes:
        equations: The equations.
        parameter_space: The parameters.
        time: Output times. Shape (t,). [s]
    """

    equations: StateEquations
    parameter_space: ParameterSpace
    time: FloatArray

    @property
    def output_names(self) -> tuple[str, ...]:
        """Names of the k outputs."""
        return self.equations.signals.outputs

    @property
    def n_operations(self) -> float:
        """About what an answer takes."""
        return self.equations.flow.n_operations

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Solve the equations of every row; one whose states run away has failed.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The trajectories, one per row, in the order of the rows.
        """
        space, theta = self.parameter_space, np.asarray(theta, dtype=np.float64)
        y = self.equations.outputs(Points.of(space, space.to_unit(theta)))
        return Trajectories.checked(
            theta,
            y,
            time=self.time,
            parameter_names=space.names,
            output_names=self.output_names,
            failures=["" if np.isfinite(row).all() else "the state equations run away" for row in y],
        )


class EquationExperiments:
    """What the state equations of several experiments answer in place of their models."""

    def __init__(self, models: Sequence[EquationModel], layout: Layout, space: ParameterSpace) -> None:
        """Put models side by side.

        Args:
            models: Of each experiment.
            layout: How their rows become one.
            space: Parameters of all experiments.
        """
        self._models, self._layout = models, layout
        self.parameter_space = space
        self.output_names, self.time = layout.output_names, layout.time

    @property
    def n_operations(self) -> float:
        """About what an answer takes."""
        return float(sum(model.n_operations for model in self._models))

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Solve the equations of every row. Shape (n, p). [per parameter]."""
        parts = zip(self._layout.experiments, self._models, strict=True)
        return self._layout.join(
            theta, [model.simulate(self._layout.theta_of(one, theta)) for one, model in parts]
        )
