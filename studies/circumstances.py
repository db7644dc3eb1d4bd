"""A row in different circumstances: with other inputs, with another step, as the first of a process."""

from dataclasses import dataclass, replace
from typing import Self

from simulation.arrays import FloatArray
from simulation.fmi.fmu import FmuSettings
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class CircumstanceModel:
    """One parameter row asked in different circumstances, whose number is the only parameter.

    Attributes:
        settings: The circumstances; all with the same outputs and output times.
        row: Parameters of the FMU. Shape (p,). [per parameter]
    """

    settings: tuple[FmuSettings, ...]
    row: FloatArray

    @property
    def parameter_space(self) -> ParameterSpace:
        """The number of the circumstance."""
        return ParameterSpace((Parameter("circumstance", -1.0, float(len(self.settings))),))

    @property
    def output_names(self) -> tuple[str, ...]:
        """The outputs."""
        return self.settings[0].output_names

    @property
    def time(self) -> FloatArray:
        """Output times. Shape (t,). [s]."""
        return self.settings[0].scenario.time

    def open(self) -> Self:
        """Return the model: the factory that worker processes are given."""
        return self

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate the row in each circumstance asked for, on an FMU opened for it.

        Args:
            theta: Numbers of circumstances. Shape (n, 1). [1]

        Returns:
            The trajectories.
        """
        answers = []
        for number in theta[:, 0]:
            with self.settings[round(number)].open() as model:
                answers.append(model.simulate(self.row[None]))
        names = self.parameter_space.names
        return replace(Trajectories.concatenate(answers), theta=theta, parameter_names=names)
