"""Models with closed forms beside `toy_rc.ToyRC`."""

from dataclasses import dataclass, field

import numpy as np
from toy_rc import ToyRC

from simulation.parameters import Parameter, ParameterSpace
from simulation.trajectories import Trajectories


def answer(model: "ProductToy | IshigamiToy", theta: np.ndarray, y: np.ndarray) -> Trajectories:
    names = model.parameter_space.names
    if theta.ndim != 2 or theta.shape[1] != len(names):
        raise ValueError(f"theta has shape {theta.shape}; expected (n, {len(names)})")
    return Trajectories.checked(
        theta, y[:, :, None], time=model.time, parameter_names=names, output_names=model.output_names
    )


@dataclass(frozen=True, eq=False)
class ProductToy:
    """A free decay through R and C that shows only their product: T(t) = T_start exp(-t / (R C)).

    The smallest case with the ambiguity of real calibrations: the product can be found, the pair cannot.
    """

    start: float = 10.0
    time: np.ndarray = field(default_factory=lambda: np.arange(25) * 3600.0)
    parameter_space: ParameterSpace = ToyRC.parameter_space
    output_names: tuple[str, ...] = ("T",)

    def simulate(self, theta: np.ndarray) -> Trajectories:
        theta = np.asarray(theta, dtype=np.float64)
        with np.errstate(all="ignore"):
            return answer(self, theta, self.start * np.exp(-self.time / (theta[..., :1] * theta[..., 1:2])))


@dataclass(frozen=True, eq=False)
class IshigamiToy:
    """Ishigami's function with a weight that changes in time: exact Sobol indices at every step.

    f_t = sin(x1) + a sin(x2)^2 + b_t x3^4 sin(x1), b_t = b t / t_end (Ishigami and Homma 1990,
    doi 10.1109/ISUMA.1990.151285). At the last step it is the classical function.
    """

    a: float = 7.0
    b: float = 0.1
    time: np.ndarray = field(default_factory=lambda: np.arange(5) * 3600.0)
    parameter_space: ParameterSpace = field(
        default_factory=lambda: ParameterSpace(
            tuple(Parameter(f"x{i}", -np.pi, np.pi, 0.0, "rad") for i in (1, 2, 3))
        )
    )
    output_names: tuple[str, ...] = ("f",)

    def simulate(self, theta: np.ndarray) -> Trajectories:
        theta = np.asarray(theta, dtype=np.float64)
        x1, x2, x3 = (theta[..., [i]] for i in range(3))
        b = self.b * self.time / self.time[-1]
        with np.errstate(all="ignore"):
            y = np.sin(x1) + self.a * np.sin(x2) ** 2 + b * x3**4 * np.sin(x1)
        return answer(self, theta, y)
