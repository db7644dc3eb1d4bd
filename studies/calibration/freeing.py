"""What fixed parameters may have cost: by differences at the optimum, what their freedom would gain."""

import math
from dataclasses import dataclass

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.counting import CountingModel
from studies.calibration.box_newton import descend
from studies.calibration.problem import CalibrationProblem
from studies.calibration.residual_process import Expansion

STEP = 0.01
"""Of the differences, as a share of the range: they extrapolate, so they need not be exact."""
REACH = 0.1
"""How far from the optimum the differences are believed, as a share of the range."""


@dataclass(frozen=True, eq=False)
class Freeing:
    """What would be gained, by differences, were fixed parameters free.

    Attributes:
        gain: Part of the objective that freeing all of them would take away; NaN where the optimum fails. [1]
        gain_alone: The same for each of the p parameters with the free ones; 0 for those, NaN where it or the
            optimum fails. Shape (p,). [1]
        n_calls: Rows asked of the model.
    """

    gain: float
    gain_alone: FloatArray
    n_calls: int


def freeing(problem: CalibrationProblem, u: FloatArray, is_free: BoolArray) -> Freeing:
    """Say what fixing has cost, as far as straight lines through the optimum tell.

    It costs a row per parameter and one more. Each fixed parameter may move by `REACH` of its range, the free
    ones with it; one whose difference fails stays where it is.

    Args:
        problem: The problem of all p parameters, posed to the physical model.
        u: The optimum of the free ones. Shape (p,). [1]
        is_free: Which parameters were calibrated. Shape (p,).
    """
    counter = CountingModel(problem.model)
    steps = np.where(u + STEP > 1.0, -STEP, STEP)
    answer = problem.on(counter).evaluate(np.vstack([u, u + np.diag(steps)]))
    m = answer.residuals.shape[1]
    here = answer.residuals[0]
    if answer.failures[0]:
        return Freeing(math.nan, np.where(is_free, 0.0, math.nan), counter.n_calls)
    slopes = (answer.residuals[1:] - here) / steps[:, None]
    fails = ~np.isfinite(slopes).all(axis=1)
    slopes[fails] = 0.0
    jacobian = slopes.T
    if problem.prior is not None:
        here = np.concatenate([here, problem.prior.rows(u[None], m)[0]])
        jacobian = np.vstack([jacobian, np.diag(problem.prior.row_slopes(m))])
    before = float(here @ here) / m

    def gain(moves: BoolArray) -> float:
        def expand(v: FloatArray) -> Expansion:
            residuals = here + jacobian @ (v - u)
            value = float(residuals @ residuals) / m
            return Expansion(value, value, 2.0 * jacobian.T @ residuals / m, 2.0 * jacobian.T @ jacobian / m)

        reach = np.where(moves, REACH, 0.0)
        _, end = descend(expand, u, np.maximum(u - reach, 0.0), np.minimum(u + reach, 1.0))
        return 1.0 - end.value / before if before > 0.0 else 0.0

    # What the free ones alone would still gain is the optimum's own roughness, and not the fixing's.
    rough = gain(is_free)
    alone = np.zeros(len(u))
    alone[fails & ~is_free] = math.nan
    for j in np.flatnonzero(~is_free & ~fails):
        alone[j] = max(gain(is_free | (np.arange(len(u)) == j)) - rough, 0.0)
    return Freeing(max(gain(np.ones_like(is_free)) - rough, 0.0), alone, counter.n_calls)
