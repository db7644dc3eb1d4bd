"""What a surrogate expects of the objective, and when it has erred."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.processes.posterior_sample import PosteriorSample
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


@dataclass(frozen=True, eq=False)
class ExpectedObjective:
    """What is minimized between two simulations: the error that processes predict, and a penalty.

    Attributes:
        process: Predicts the error.
        penalty: What a prior or failures add to it, None for nothing.
    """

    process: ProcessGroups
    penalty: Penalty | None = None

    def expand(self, u: FloatArray, caution: float) -> Expansion:
        """Expand it around a point (p,); caution is the part of the variance in it."""
        return self._penalized(self.process.expand(u, caution), u)

    def at(self, u: FloatArray) -> FloatArray:
        """Return it at points (n, p) if the mean predictions are right. Shape (n,). [unit squared]."""
        errors = self.process.errors(u)
        return errors if self.penalty is None else errors + self.penalty.penalty(u)

    def drawn(self, rng: np.random.Generator) -> Callable[[FloatArray], Expansion]:
        """Return a function, drawn from the posterior, that may be the true objective."""
        sample = PosteriorSample.draw(self.process, rng)
        return lambda u: self._penalized(sample.expand(u), u)

    def _penalized(self, error: Expansion, u: FloatArray) -> Expansion:
        return error if self.penalty is None else error + self.penalty.expand(u)

    def excludes(self, u: FloatArray, expected: Expansion, best: Incumbent) -> bool:
        """Return whether a point is not worth a call: the best one is as good, as far as can be predicted.

        Args:
            u: The point. Shape (p,). [1]
            expected: The objective expected there.
            best: The best simulation.
        """
        there = self.process.expand(u, 1.0)
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
