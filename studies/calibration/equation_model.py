"""A model that answers by state equations: no simulation, next to no time."""

from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories
from studies.calibration.coefficient import Points
from studies.calibration.state_equations import StateEquations


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

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Solve the equations of every row; one whose states run away has failed.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The trajectories, one per row, in the order of the rows.
        """
        space, theta = self.parameter_space, np.asarray(theta, dtype=np.float64)
        y = self.equations.outputs(Points.of(space, space.to_unit(theta)))
        reasons = ["" if np.isfinite(row).all() else "the state equations run away" for row in y]
        return Trajectories.checked(
            theta,
            y,
            time=self.time,
            parameter_names=space.names,
            output_names=self.output_names,
            failures=reasons,
        )
