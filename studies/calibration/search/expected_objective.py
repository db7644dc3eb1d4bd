"""What a surrogate expects of the objective, and when it has erred."""

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.processes.posterior_sample import PosteriorSample
from studies.calibration.processes.process import ResidualProcess
from studies.calibration.search.constants import SEARCH
from studies.calibration.search.failures import Penalty

Surrogate = ResidualProcess | ProcessGroups


def expected_objective(
    process: Surrogate | PosteriorSample, prior: Penalty | None, u: FloatArray, caution: float
) -> Expansion:
    """Expand the objective around a point: the error is predicted, a prior's penalty is known."""
    found = process.expand(u, caution)
    return found if prior is None else found + prior.expand(u)


def is_surely_no_better(
    process: Surrogate, u: FloatArray, expected: Expansion, best: float, outlying: float = 0.0
) -> bool:
    """Return whether a point is not worth a call: the best row is as good, as far as can be predicted.

    Args:
        process: The surrogate.
        u: The point. Shape (p,). [1]
        expected: The objective expected there.
        best: Objective of the best row. [unit squared]
        outlying: Its largest samples' part, without which gains are measured. [unit squared]
    """
    there, rest = process.expand(u, 1.0), best - outlying
    is_known = there.value - there.mse < SEARCH.uncertain * rest
    return is_known and expected.value - outlying > SEARCH.as_good * rest


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
    if not np.isfinite(found) or predicted > (1.0 + SEARCH.surprise) * favourite:
        found = predicted
    return max(found - predicted, favourite - best) > SEARCH.surprise * max(best, predicted)
