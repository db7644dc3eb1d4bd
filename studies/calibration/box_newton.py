"""Newton steps with Levenberg-Marquardt damping inside a box, for functions that cost nothing."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray

# Steps, and attempts of each: by hand, most descents end after a few.
MAX_STEPS, MAX_DAMPINGS = 40, 12
# Relative to the curvature: rounding, and by hand. The relative gain that ends a descent is by hand, too.
LEAST_DAMPING, FIRST_DAMPING, FTOL = 1e-9, 1e-3, 1e-6
# Below this distance two points are one. By hand. [unit cube]
SAME_POINT = 1e-4


@dataclass(frozen=True, eq=False)
class Expansion:
    """An objective, or a part of it, around a point, to second order; parts add up.

    Attributes:
        value: What is minimized: squared mean prediction plus caution times the variance, or a penalty.
            [unit squared]
        mse: The error if the mean prediction is right, 0 for a penalty. [unit squared]
        derivatives: Returns gradient and Hessian. A step that is refused, about every second one, needs none
            of them, and they are most of the work.
    """

    value: float
    mse: float
    derivatives: Callable[[], tuple[FloatArray, FloatArray]]

    @classmethod
    def known(cls, value: float, mse: float, gradient: FloatArray, hessian: FloatArray) -> Self:
        """Return an expansion whose derivatives cost nothing."""
        return cls(value, mse, lambda: (gradient, hessian))

    @cached_property
    def _derivatives(self) -> tuple[FloatArray, FloatArray]:
        return self.derivatives()

    @property
    def gradient(self) -> FloatArray:
        """Gradient of the value. Shape (p,). [unit squared]."""
        return self._derivatives[0]

    @property
    def hessian(self) -> FloatArray:
        """Positive semidefinite part, as in Gauss-Newton's method. Shape (p, p). [unit squared]."""
        return self._derivatives[1]

    def __add__(self, other: "Expansion") -> "Expansion":
        """Return the sum of two parts."""
        return Expansion(
            self.value + other.value,
            self.mse + other.mse,
            lambda: (self.gradient + other.gradient, self.hessian + other.hessian),
        )


def descend(
    expand: Callable[[FloatArray], Expansion],
    start: FloatArray,
    lower: FloatArray | float = 0.0,
    upper: FloatArray | float = 1.0,
    *,
    ftol: float = FTOL,
) -> tuple[FloatArray, Expansion]:
    """Walk downhill from a point to a minimum in a box.

    Args:
        expand: The function: value, gradient and a positive semidefinite Hessian at a point.
        start: First point, clipped into the box. Shape (p,). [1]
        lower: Lower bounds, that of the unit cube if not given. Shape (p,). [1]
        upper: Upper bounds. Shape (p,). [1]
        ftol: A step that lowers the function by less than this part is the last. [1]

    Returns:
        The last point and the function there.
    """
    u = np.clip(start, lower, upper)
    here = expand(u)
    damping = FIRST_DAMPING
    for _ in range(MAX_STEPS):
        # Where the slope points out of the box, a coordinate is held at its
        # face (projected Newton method, Bertsekas 1982, doi:10.1137/0320018).
        held = ((u <= lower) & (here.gradient > 0.0)) | ((u >= upper) & (here.gradient < 0.0))
        if held.all():
            break
        for _ in range(MAX_DAMPINGS):
            trial = _damped_step(u, here, damping, ~held, lower, upper)
            there = expand(trial)
            if there.value < here.value:
                break
            damping *= 4.0
        # No damping lowers the function: within rounding, this is a minimum.
        else:
            break
        gain = here.value - there.value
        u, here, damping = trial, there, max(damping / 5.0, LEAST_DAMPING)
        if gain < ftol * abs(here.value):
            break
    return u, here


def _damped_step(
    u: FloatArray,
    here: Expansion,
    damping: float,
    free: BoolArray,
    lower: FloatArray | float,
    upper: FloatArray | float,
) -> FloatArray:
    """Return the damped Newton point; coordinates that leave the box stop at its face. Shape (p,)."""
    step = np.zeros_like(u)
    free = free.copy()
    # Every turn fixes a coordinate at least, so that there are at most as many as parameters.
    while free.any():
        block = here.hessian[np.ix_(free, free)]
        # Marquardt's damping by the diagonal; the trace's
        # small share holds directions that have no curvature.
        ridge = damping * np.diag(block) + 1e-12 * np.trace(block) + np.finfo(float).tiny
        # The others answer to coordinates that stop at a face; cutting the step alone may leave the valley.
        slope = here.gradient[free] + here.hessian[np.ix_(free, ~free)] @ step[~free]
        step[free] = -np.linalg.solve(block + np.diag(ridge), slope)
        beyond = free & ((u + step < lower) | (u + step > upper))
        if not beyond.any():
            break
        step[beyond] = np.clip(u + step, lower, upper)[beyond] - u[beyond]
        free &= ~beyond
    return np.clip(u + step, lower, upper)
