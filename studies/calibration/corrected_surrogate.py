"""A trained surrogate that leads a search, corrected by what the simulations so far show of its error.

The residuals are the surrogate's and a Gaussian process of what it misses: a discrepancy as of Kennedy and
O'Hagan 2001 (doi 10.1111/1467-9868.00294), with the surrogate in the place of the coarse model.
"""

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.guide import Guide
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.processes.groups import NOISE_POWER
from studies.calibration.processes.kernel import Belief, between, inverse_factor, kernel_matrix, most_probable
from studies.calibration.processes.process import LEAST_LOOSENESS, Features

# Points that are looked at, and how many of the best of them are walked downhill: the box was screened.
N_LOOKS, N_WALKS = 64, 3


class CorrectedSurrogate(Guide):
    """A surrogate of a calibration problem, and what rows show of its error."""

    NAME = "the surrogate, corrected by the simulations so far"

    def __init__(self, surrogate: CalibrationProblem, seed: int) -> None:
        """Begin with the surrogate alone.

        Args:
            surrogate: The problem, posed to the surrogate.
            seed: Seed of all draws.
        """
        space = surrogate.space
        rng = np.random.default_rng([seed, space.n_parameters])
        super().__init__(surrogate, rng, n_looks=N_LOOKS, n_walks=N_WALKS)
        self._features = Features.of(space)
        m = surrogate.measurement.n_samples
        self._own, self._missed = np.empty((0, m)), np.empty((0, m))
        self._hyper: FloatArray | None = None

    def _keep(self, answer: Evaluation, good: np.ndarray) -> None:
        found = answer.residuals[good]
        self._own = np.concatenate([self._own, found])
        if len(good):
            self._missed = np.concatenate([self._missed, found - self._problem.residuals(answer.u[good])])

    def _learn(self) -> bool:
        """Fit the process to what the surrogate missed."""
        if len(self._u) < 2 or not np.isfinite(self._missed).all():
            return False
        best = int(np.argmin(self._objective))
        self._level = self._missed[best]
        # n rows differ in n directions at most.
        self._basis, triangle = np.linalg.qr((self._missed - self._level).T)
        values = triangle.T
        # As in the processes of a search: of a row far from the measurement little has to be known.
        squares = np.square(self._own).sum(axis=1)
        looseness = np.maximum((squares / squares.mean()) ** NOISE_POWER, LEAST_LOOSENESS)
        self._x = self._features.at(self._u)
        belief = Belief.of(self._x.shape[1])
        self._hyper = most_probable(self._x, values, looseness, belief, self._hyper)
        factor = inverse_factor(kernel_matrix(self._x, self._hyper, looseness)[0])
        self._coefficients = factor.T @ (factor @ values)
        return True

    def _residuals(self, u: FloatArray) -> FloatArray:
        assert self._hyper is not None, "it has learnt before it is asked"
        missed = between(self._features.at(u), self._x, self._hyper) @ self._coefficients
        return np.asarray(self._problem.residuals(u) + self._level + missed @ self._basis.T)
