"""Models with closed forms, small enough to know every answer: for tests and for teaching."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from simulation.arrays import FloatArray
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories


def _hourly(n_hours: int) -> FloatArray:
    return np.arange(n_hours + 1, dtype=np.float64) * 3600.0


@dataclass(frozen=True, eq=False)
class _Toy(ABC):
    """A function of R [K/W] and C [J/K], both logarithmic, or of other parameters that a subclass names.

    Attributes:
        time: Output times. Shape (t,). [s]
    """

    parameter_space: ClassVar[ParameterSpace] = ParameterSpace(
        (
            Parameter("R", lower=0.2, upper=5.0, estimate=1.0, unit="K/W", scale="log"),
            Parameter("C", lower=0.2e4, upper=5e4, estimate=1e4, unit="J/K", scale="log"),
        )
    )
    output_names: ClassVar[tuple[str, ...]] = ("T",)
    time: FloatArray = field(default_factory=lambda: _hourly(24), kw_only=True)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Evaluate the closed form.

        Args:
            theta: Parameters. Shape (n, p). [per parameter]

        Returns:
            The answers. y of shape (n, t, 1).
        """
        theta = np.asarray(theta, dtype=np.float64)
        names = self.parameter_space.names
        if theta.ndim != 2 or theta.shape[1] != len(names):
            raise ValueError(f"theta has shape {theta.shape}; expected (n, {len(names)})")
        with np.errstate(all="ignore"):
            y = self._closed_form(theta)[:, :, None]
        failures = [self._failure(row) for row in theta]
        return Trajectories.checked(
            theta, y, time=self.time, parameter_names=names, output_names=self.output_names, failures=failures
        )

    @abstractmethod
    def _closed_form(self, theta: FloatArray) -> FloatArray:
        """Return the outputs of rows of shape (n, p). Shape (n, t)."""

    def _failure(self, row: FloatArray) -> str:
        """Say why a row of shape (p,) fails, "" where it does not."""
        return ""


@dataclass(frozen=True, eq=False)
class ToyRC(_Toy):
    """One heated capacity C behind one resistance R: T(t) = T_ambient + q R (1 - exp(-t / (R C))).

    Attributes:
        heat_flow: Constant heat flow q. [W]
        ambient: Outside and initial temperature. [degC]
        fails_above_r: Rows with a larger R fail, to try how failures are handled; None for never. [K/W]
    """

    heat_flow: float = 10.0
    ambient: float = 10.0
    fails_above_r: float | None = None

    def _closed_form(self, theta: FloatArray) -> FloatArray:
        r, c = theta[:, :1], theta[:, 1:]
        return np.asarray(self.ambient + self.heat_flow * r * -np.expm1(-self.time / (r * c)))

    def _failure(self, row: FloatArray) -> str:
        most = self.fails_above_r
        return "" if most is None or not row[0] > most else f"R = {row[0]:g} K/W is above {most:g}"


@dataclass(frozen=True, eq=False)
class ProductToy(_Toy):
    """A free decay through R and C that shows only their product: T(t) = T_start exp(-t / (R C)).

    The smallest case with the ambiguity of real calibrations: the product can be found, the pair cannot.

    Attributes:
        start: Initial temperature above the surroundings. [K]
    """

    start: float = 10.0

    def _closed_form(self, theta: FloatArray) -> FloatArray:
        return np.asarray(self.start * np.exp(-self.time / (theta[:, :1] * theta[:, 1:])))


@dataclass(frozen=True, eq=False)
class IshigamiToy(_Toy):
    """Ishigami's function with a weight that changes in time: exact Sobol indices at every step.

    f_t = sin(x1) + a sin(x2)^2 + b_t x3^4 sin(x1), b_t = b t / t_end (Ishigami and Homma 1990,
    doi 10.1109/ISUMA.1990.151285). At the last step it is the classical function.

    Attributes:
        a: Weight of the second term. [1]
        b: Weight of the third term at the last step. [1]
    """

    parameter_space: ClassVar[ParameterSpace] = ParameterSpace(
        tuple(Parameter(f"x{i}", -np.pi, np.pi, 0.0, "rad") for i in (1, 2, 3))
    )
    output_names: ClassVar[tuple[str, ...]] = ("f",)
    a: float = 7.0
    b: float = 0.1
    time: FloatArray = field(default_factory=lambda: _hourly(4), kw_only=True)

    def _closed_form(self, theta: FloatArray) -> FloatArray:
        x1, x2, x3 = (theta[:, [i]] for i in range(3))
        b = self.b * self.time / self.time[-1]
        return np.asarray(np.sin(x1) + self.a * np.sin(x2) ** 2 + b * x3**4 * np.sin(x1))
