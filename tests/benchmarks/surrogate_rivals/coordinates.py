"""What the rivals share: features of the parameters, principal coordinates of the trajectories, a fit."""

from collections.abc import Callable
from dataclasses import dataclass
from time import process_time

import numpy as np

from simulation import ParameterSpace
from simulation.arrays import BoolArray, FloatArray
from surrogate_rivals.problems import Data

# Part of the training set's variance that the coordinates leave out unless set.
LEFT_OUT = 1e-6
Z_90 = 1.6448536269514722  # standard deviations from the middle to the end of a normal 90 % band


@dataclass(frozen=True, eq=False)
class Fitted:
    """A trained surrogate.

    Attributes:
        predict: Parameters (n, p) to trajectories (n, t, k).
        fit_s: CPU time of the last fit alone, choices made. [s]
        settings: What was chosen, in words.
        deviation: Parameters (n, p) to standard deviations (n, t, k), where the method states them.
    """

    predict: Callable[[FloatArray], FloatArray]
    fit_s: float
    settings: str = ""
    deviation: Callable[[FloatArray], FloatArray] | None = None


@dataclass(frozen=True, eq=False)
class Features:
    """Parameters between -1/2 and 1/2, linear and, where the case is logarithmic, logarithmic.

    Attributes:
        lower: Shape (p,). [per parameter]
        upper: Shape (p,). [per parameter]
        is_log: Shape (p,).
    """

    lower: FloatArray
    upper: FloatArray
    is_log: BoolArray

    @classmethod
    def of(cls, space: ParameterSpace) -> "Features":
        """Return the features of a box."""
        return cls(space.lower, space.upper, space.is_log)

    def linear(self, theta: FloatArray) -> FloatArray:
        """Return all parameters in their unit. Shape (n, p). [1]."""
        return (theta - self.lower) / (self.upper - self.lower) - 0.5

    def logarithmic(self, theta: FloatArray) -> FloatArray:
        """Return the case's own coordinates. Shape (n, p). [1]."""
        found = self.linear(theta)
        log = self.is_log
        found[:, log] = (
            np.log(theta[:, log] / self.lower[log]) / np.log(self.upper[log] / self.lower[log]) - 0.5
        )
        return found

    def both(self, theta: FloatArray) -> FloatArray:
        """Return both. Shape (n, p + l). [1]."""
        return np.concatenate([self.linear(theta), self.logarithmic(theta)[:, self.is_log]], axis=1)


@dataclass(frozen=True, eq=False)
class Principal:
    """Principal coordinates of training trajectories, in units in which the outputs' errors compare.

    Attributes:
        mean: Shape (t, k). [output's unit]
        basis: Orthonormal rows. Shape (q, t * k).
        scales: Of the outputs. Shape (k,).
        left_out: Variance outside the basis. Shape (t, k). [output's unit squared]
    """

    mean: FloatArray
    basis: FloatArray
    scales: FloatArray
    left_out: FloatArray

    @classmethod
    def of(cls, data: Data, left_out: float = LEFT_OUT) -> "Principal":
        """Learn them from the training set.

        Args:
            data: The training set.
            left_out: Part of its variance that they may leave out.
        """
        mean = data.y.mean(axis=0)
        x = ((data.y - mean) * data.output_scales).reshape(len(data.y), -1)
        _, values, rows = np.linalg.svd(x, full_matrices=False)
        part = 1.0 - np.cumsum(values**2) / np.sum(values**2)
        q = min(int(np.argmax(part <= left_out)) + 1, max(1, len(x) - 1))
        basis = rows[:q]
        rest = ((x - x @ basis.T @ basis) ** 2).mean(axis=0).reshape(mean.shape)
        return cls(mean, basis, data.output_scales, rest / data.output_scales**2)

    def coordinates(self, y: FloatArray) -> FloatArray:
        """Return the coordinates of trajectories. Shape (n, q)."""
        return ((y - self.mean) * self.scales).reshape(len(y), -1) @ self.basis.T

    def outputs(self, z: FloatArray) -> FloatArray:
        """Return the trajectories of coordinates. Shape (n, t, k). [output's unit]."""
        return (z @ self.basis).reshape(len(z), *self.mean.shape) / self.scales + self.mean

    def deviation(self, variance: FloatArray) -> FloatArray:
        """Turn independent variances of the coordinates (n, q) into deviations. Shape (n, t, k)."""
        spread = (variance @ self.basis**2).reshape(len(variance), *self.mean.shape) / self.scales**2
        return np.asarray(np.sqrt(spread + self.left_out))


def error(z: FloatArray, true: FloatArray) -> float:
    """Return the mean over rows of the root of the squared error over coordinates; what choices minimize."""
    return float(np.sqrt(((z - true) ** 2).sum(axis=1)).mean())


class Clock:
    """CPU time of this process since it was made."""

    def __init__(self) -> None:
        self._start = process_time()

    @property
    def s(self) -> float:
        """CPU time so far. [s]."""
        return process_time() - self._start
