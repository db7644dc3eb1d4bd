"""A model with a closed form, small enough to know every answer."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from simulation.arrays import FloatArray
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class ToyRC:
    """One heated capacity C behind one resistance R: T(t) = T_ambient + q R (1 - exp(-t / (R C))).

    Attributes:
        heat_flow: Constant heat flow q. [W]
        ambient: Outside and initial temperature. [degC]
        fails_above_r: Rows with a larger R fail, to try how failures are handled; None for never. [K/W]
        time: Output times. Shape (t,). [s]
    """

    parameter_space: ClassVar = ParameterSpace(
        (
            Parameter("R", lower=0.2, upper=5.0, estimate=1.0, unit="K/W", scale="log"),
            Parameter("C", lower=0.2e4, upper=5e4, estimate=1e4, unit="J/K", scale="log"),
        )
    )
    output_names: ClassVar = ("T",)
    heat_flow: float = 10.0
    ambient: float = 10.0
    fails_above_r: float | None = None
    time: FloatArray = field(default_factory=lambda: np.arange(25, dtype=np.float64) * 3600.0)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Evaluate the closed form.

        Args:
            theta: R and C. Shape (n, 2). [K/W, J/K]

        Returns:
            The temperatures. y of shape (n, t, 1). [degC]
        """
        theta = np.asarray(theta, dtype=np.float64)
        if theta.ndim != 2 or theta.shape[1] != 2:
            raise ValueError(f"theta has shape {theta.shape}; expected (n, 2)")
        r, c = theta[:, :1], theta[:, 1:]
        with np.errstate(all="ignore"):
            y = self.ambient + self.heat_flow * r * -np.expm1(-self.time / (r * c))
        most = np.inf if self.fails_above_r is None else self.fails_above_r
        return Trajectories.checked(
            theta,
            y[:, :, None],
            time=self.time,
            parameter_names=self.parameter_space.names,
            output_names=self.output_names,
            failures=[f"R = {one:g} K/W is above {most:g}" if one > most else "" for one in theta[:, 0]],
        )
