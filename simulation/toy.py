"""Models with closed forms, small enough to know every answer: for tests and for teaching."""

from dataclasses import dataclass, field

import numpy as np

from simulation.arrays import FloatArray
from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories

_RC_SPACE = ParameterSpace(
    (
        Parameter("R", lower=0.2, upper=5.0, estimate=1.0, unit="K/W", scale="log"),
        Parameter("C", lower=0.2e4, upper=5e4, estimate=1e4, unit="J/K", scale="log"),
    )
)


def _hourly(n_hours: int) -> FloatArray:
    return np.arange(n_hours + 1, dtype=np.float64) * 3600.0


@dataclass(frozen=True, eq=False)
class ToyRC:
    """One heated capacity C behind one resistance R: T(t) = T_ambient + q R (1 - exp(-t / (R C))).

    Attributes:
        heat_flow: Constant heat flow q. [W]
        ambient: Outside and initial temperature. [degC]
        fails_above_r: Rows with a larger R fail, to try how failures are handled; None for never. [K/W]
        time: Output times. Shape (t,). [s]
    """

    heat_flow: float = 10.0
    ambient: float = 10.0
    fails_above_r: float | None = None
    time: FloatArray = field(default_factory=lambda: _hourly(24))

    @property
    def parameter_space(self) -> ParameterSpace:
        """R [K/W] and C [J/K], logarithmic."""
        return _RC_SPACE

    @property
    def output_names(self) -> tuple[str, ...]:
        """The capacity's temperature. [degC]."""
        return ("T",)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Evaluate the closed form.

        Args:
            theta: R and C. Shape (n, 2). [K/W, J/K]

        Returns:
            The temperatures. y of shape (n, t, 1). [degC]
        """
        theta = _checked_theta(theta, self.parameter_space)
        r, c = theta[:, :1], theta[:, 1:]
        with np.errstate(all="ignore"):
            y = self.ambient + self.heat_flow * r * -np.expm1(-self.time / (r * c))
        failures = [
            f"R = {row[0]:g} K/W is above {self.fails_above_r:g}"
            if self.fails_above_r is not None and row[0] > self.fails_above_r
            else ""
            for row in theta
        ]
        return _answer(self, theta, y[:, :, None], failures)


@dataclass(frozen=True, eq=False)
class ProductToy:
    """A free decay through R and C that shows only their product: T(t) = T_start exp(-t / (R C)).

    The smallest case with the ambiguity of real calibrations: the product can be found, the pair cannot.

    Attributes:
        start: Initial temperature above the surroundings. [K]
        time: Output times. Shape (t,). [s]
    """

    start: float = 10.0
    time: FloatArray = field(default_factory=lambda: _hourly(24))

    @property
    def parameter_space(self) -> ParameterSpace:
        """R [K/W] and C [J/K], logarithmic."""
        return _RC_SPACE

    @property
    def output_names(self) -> tuple[str, ...]:
        """The temperature above the surroundings. [K]."""
        return ("T",)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Evaluate the closed form.

        Args:
            theta: R and C. Shape (n, 2). [K/W, J/K]

        Returns:
            The temperatures above the surroundings. y of shape (n, t, 1). [K]
        """
        theta = _checked_theta(theta, self.parameter_space)
        with np.errstate(all="ignore"):
            y = self.start * np.exp(-self.time / (theta[:, :1] * theta[:, 1:]))
        return _answer(self, theta, y[:, :, None])


@dataclass(frozen=True, eq=False)
class IshigamiToy:
    """Ishigami's function with a weight that changes in time: exact Sobol indices at every step.

    f_t = sin(x1) + a sin(x2)^2 + b_t x3^4 sin(x1), b_t = b t / t_end (Ishigami and Homma 1990,
    doi 10.1109/ISUMA.1990.151285). At the last step it is the classical function.

    Attributes:
        a: Weight of the second term. [1]
        b: Weight of the third term at the last step. [1]
        time: Output times. Shape (t,). [s]
    """

    a: float = 7.0
    b: float = 0.1
    time: FloatArray = field(default_factory=lambda: _hourly(4))

    @property
    def parameter_space(self) -> ParameterSpace:
        """Three angles between -pi and pi."""
        return ParameterSpace(tuple(Parameter(f"x{i}", -np.pi, np.pi, 0.0, "rad") for i in (1, 2, 3)))

    @property
    def output_names(self) -> tuple[str, ...]:
        """The function's value."""
        return ("f",)

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Evaluate the function.

        Args:
            theta: The three angles. Shape (n, 3). [rad]

        Returns:
            The values. y of shape (n, t, 1). [1]
        """
        theta = _checked_theta(theta, self.parameter_space)
        x1, x2, x3 = (theta[:, [i]] for i in range(3))
        b = self.b * self.time / self.time[-1]
        with np.errstate(all="ignore"):
            y = np.sin(x1) + self.a * np.sin(x2) ** 2 + b * x3**4 * np.sin(x1)
        return _answer(self, theta, y[:, :, None])


def _checked_theta(theta: FloatArray, space: ParameterSpace) -> FloatArray:
    theta = np.asarray(theta, dtype=np.float64)
    if theta.ndim != 2 or theta.shape[1] != space.n_parameters:
        raise ValueError(f"theta has shape {theta.shape}; expected (n, {space.n_parameters})")
    return theta


def _answer(
    model: ToyRC | ProductToy | IshigamiToy,
    theta: FloatArray,
    y: FloatArray,
    failures: list[str] | None = None,
) -> Trajectories:
    return Trajectories.checked(
        theta,
        y,
        time=model.time,
        parameter_names=model.parameter_space.names,
        output_names=model.output_names,
        failures=failures,
    )
