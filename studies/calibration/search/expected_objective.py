"""What a surrogate expects of the objective, and when it has erred."""

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.processes.posterior_sample import PosteriorSample
from studies.calibration.processes.process import ResidualProcess
from studies.calibration.search.failures import Penalty
from studies.calibration.search.rows import Incumbent

# Part of the predictive variance that counts as error: 0 trusts the surrogate's mean. By hand.
CAUTION = 0.1
# A point is surely no better if it is expected above the first part of the best error, with a variance below
# the second part of it. By definition of a right answer, 1.02 times the best error; by hand.
AS_GOOD, UNCERTAIN = 0.98, 0.1
# Part of the error by which a surrogate that knows a local minimum does not err
# (docs/notes/adaptive-search.md, Truncated windows).
SURPRISE = 0.1

Surrogate = ResidualProcess | ProcessGroups


def expected_objective(
    surrogate: Surrogate | PosteriorSample, penalty: Penalty | None, u: FloatArray, caution: float
) -> Expansion:
    """Expand the objective around a point: the error is predicted, a penalty is known."""
    expansion = surrogate.expand(u, caution)
    return expansion if penalty is None else expansion + penalty.expand(u)


def is_surely_no_better(surrogate: Surrogate, u: FloatArray, expected: Expansion, best: Incumbent) -> bool:
    """Return whether a point is not worth a call: the best one is as good, as far as can be predicted.

    Args:
        surrogate: The surrogate.
        u: The point. Shape (p,). [1]
        expected: The objective expected there.
        best: The best simulation.
    """
    there = surrogate.expand(u, 1.0)
    is_known = there.value - there.mse < UNCERTAIN * best.rest
    return is_known and expected.value - best.outlying > AS_GOOD * best.rest


def is_surprised(found: float, predicted: float, favourite: float, best: float) -> bool:
    """Return whether a surrogate does not reproduce its best row, or has erred in its favourite point.

    The little gain that it expects is then no reason to end.

    Args:
        found: Objective of the point that was asked, infinite where it failed. [unit squared]
        predicted: The same as predicted. [unit squared]
        favourite: Predicted for the favourite; another point is simulated where that is known. [unit squared]
        best: Objective of the best row before. [unit squared]
    """
    # A failed row shows no error of the prediction; a point much
    # worse than the favourite was asked because that one is known.
    if not np.isfinite(found) or predicted > (1.0 + SURPRISE) * favourite:
        found = predicted
    return max(found - predicted, favourite - best) > SURPRISE * max(best, predicted)
