"""A row in different circumstances: with other inputs, with another step, as the first of a process."""

from dataclasses import dataclass, replace
from typing import Self

from simulation.arrays import FloatArray
from simulation.fmi.fmu import FmuSettings
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class _InCircumstances:
    """What models have in common that simulate an FMU in different circumstances.

    Attributes:
        settings: The circumstances; all with the same outputs and output times.
    """

    settings: tuple[FmuSettings, ...]

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


@dataclass(frozen=True, eq=False)
class CircumstanceModel(_InCircumstances):
    """One parameter row asked in different circumstances, whose number is the only parameter.

    Attributes:
        settings: The circumstances; all with the same outputs and output times.
        row: Parameters of the FMU. Shape (p,). [per parameter]
    """

    row: FloatArray

    @property
    def parameter_space(self) -> ParameterSpace:
        """The number of the circumstance."""
        return ParameterSpace((Parameter("circumstance", -1.0, float(len(self.settings))),))

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


@dataclass(frozen=True, eq=False)
class RowsInCircumstances(_InCircumstances):
    """Some parameter rows asked in different circumstances; numbers of both are the parameters.

    Attributes:
        settings: The circumstances; all with the same outputs and output times.
        rows: Parameters of the FMU. Shape (m, p). [per parameter]
    """

    rows: FloatArray

    @property
    def parameter_space(self) -> ParameterSpace:
        """The numbers of the circumstance and of the row."""
        sizes = {"circumstance": len(self.settings), "row": len(self.rows)}
        return ParameterSpace(tuple(Parameter(name, -1.0, float(n)) for name, n in sizes.items()))

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate each row in its circumstance, on an FMU opened for it.

        Args:
            theta: Numbers of circumstances and rows. Shape (n, 2). [1]

        Returns:
            The trajectories.
        """
        answers = []
        for number, row in theta:
            with self.settings[round(number)].open() as model:
                answers.append(model.simulate(self.rows[[round(row)]]))
        names = self.parameter_space.names
        return replace(Trajectories.concatenate(answers), theta=theta, parameter_names=names)
