"""What a surrogate expects of the objective, and when it has erred."""

from dataclasses import replace

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.failures import Penalty
from studies.calibration.posterior_sample import PosteriorSample
from studies.calibration.process_groups import ProcessGroups
from studies.calibration.residual_process import Expansion, ResidualProcess

Surrogate = ResidualProcess | ProcessGroups

# Expected above this part of the best error, with a variance below `UNCERTAIN` of it, is surely no better.
AS_GOOD, UNCERTAIN = 0.98, 0.1
# Part of the error by which a surrogate that knows a valley's bottom does not err.
SURPRISE = 0.1


def expected_objective(
    process: Surrogate | PosteriorSample, prior: Penalty | None, u: FloatArray, caution: float
) -> Expansion:
    """Expand the objective around a point: the error is predicted, a prior's penalty is known."""
    found = process.expand(u, caution)
    if prior is None:
        return found
    penalty, gradient, hessian = prior.expand(u)
    return replace(
        found,
        value=found.value + penalty,
        gradient=found.gradient + gradient,
        hessian=found.hessian + hessian,
    )


def is_surely_no_better(process: Surrogate, u: FloatArray, expected: Expansion, best: float) -> bool:
    """Return whether a point is not worth a call: the best row is as good, as far as can be predicted.

    Args:
        process: The surrogate.
        u: The point. Shape (p,). [1]
        expected: The objective expected there.
        best: Objective of the best row. [unit squared]
    """
    there = process.expand(u, 1.0)
    return there.value - there.mse < UNCERTAIN * best and expected.value > AS_GOOD * best


def is_surprised(found: float, predicted: float, favourite: float, best: float) -> bool:
    """Return whether a surrogate does not reproduce its best row, or has erred in its favourite point.

    The little gain that it expects is then no reason to end.

    Args:
        found: Objective of the point that was asked, infinite where it failed. [unit squared]
        predicted: The same as predicted. [unit squared]
        favourite: Predicted for the favourite; another point is simulated where that is known. [unit squared]
        best: Objective of the best row before. [unit squared]
    """
    if not np.isfinite(found) or predicted > (1.0 + SURPRISE) * favourite:
        found = predicted
    return max(found - predicted, favourite - best) > SURPRISE * max(best, predicted)
