"""A trained surrogate that leads a search, corrected by what the simulations so far show of its error.

The residuals are the surrogate's and a Gaussian process of what it misses: a discrepancy as of Kennedy and
O'Hagan 2001 (doi 10.1111/1467-9868.00294), with the surrogate in the place of the coarse model.
"""

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.leader import Leader
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.processes.groups import NOISE_POWER
from studies.calibration.processes.kernel import Belief, between, inverse_factor, kernel_matrix, most_probable
from studies.calibration.processes.process import LEAST_LOOSENESS, Features

# Share of the surrogate below which the rows are predicted as well without it.
LEAST_SHARE = 0.5
# Points that are looked at, and how many of the best of them are walked downhill: the box was screened.
N_LOOKS, N_WALKS = 64, 3


class CorrectedSurrogate(Leader):
    """A surrogate of a calibration problem, and what rows show of its error.

    Attributes:
        share: Part of the surrogate's residuals that counts; the process predicts the rest. [1]
    """

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
        self._own, self._predicted = np.empty((0, m)), np.empty((0, m))
        # Rows that were known beforehand; the surrogate may have been trained on them.
        self._n_known: int | None = None
        self.share = 1.0
        self._hyper: FloatArray | None = None

    def _keep(self, answer: Evaluation, good: np.ndarray) -> None:
        self._own = np.concatenate([self._own, answer.residuals[good]])
        if len(good):
            predicted = self._problem.residuals(answer.u[good])
            self._predicted = np.concatenate([self._predicted, predicted])
        if self._n_known is None:
            self._n_known = len(good)

    def _learn(self) -> bool:
        """Fit the process to what the surrogate missed, and find which share of it counts."""
        if len(self._u) < 2 or not np.isfinite(self._predicted).all():
            return False
        best = int(np.argmin(self._objective))
        own, predicted = self._own - self._own[best], self._predicted - self._predicted[best]
        # n rows differ in n directions at most.
        _, triangle = np.linalg.qr((own - self.share * predicted).T)
        # As in the processes of a search: of a row far from the measurement little has to be known.
        squares = np.square(self._own).sum(axis=1)
        looseness = np.maximum((squares / squares.mean()) ** NOISE_POWER, LEAST_LOOSENESS)
        self._x = self._features.at(self._u)
        belief = Belief.of(self._x.shape[1])
        self._hyper = most_probable(self._x, triangle.T, looseness, belief, self._hyper)
        factor = inverse_factor(kernel_matrix(self._x, self._hyper, looseness)[0])
        inverse = factor.T @ factor
        self.share = self._share_of(inverse, own, predicted, squares)
        self._best = best
        self._coefficients = inverse @ (own - self.share * predicted)
        return self.share >= LEAST_SHARE

    def _share_of(
        self, inverse: FloatArray, own: FloatArray, predicted: FloatArray, squares: FloatArray
    ) -> float:
        """Return the share of the surrogate with which the new rows are predicted best, each by all others.

        The errors of such predictions follow from the inverse of the kernel matrix (Rasmussen and Williams
        2006, Eq. 5.12), and are linear in the share. Training rows say nothing of it: the surrogate knows
        them.
        """
        new = np.arange(len(own)) >= (self._n_known or 0)
        if not new.any():
            return 1.0
        variance = 1.0 / np.diag(inverse)[new]
        of_own, of_surrogate = (variance[:, None] * (inverse[new] @ one) for one in (own, predicted))
        weight = 1.0 / squares[new]
        size = weight @ np.square(of_surrogate).sum(axis=1)
        product = weight @ (of_own * of_surrogate).sum(axis=1)
        return float(np.clip(product / size, 0.0, 1.0)) if size > 0.0 else 1.0

    def _residuals(self, u: FloatArray) -> FloatArray:
        assert self._hyper is not None, "it has learnt before it is asked"
        beyond = between(self._features.at(u), self._x, self._hyper) @ self._coefficients
        predicted = self._problem.residuals(u) - self._predicted[self._best]
        return np.asarray(self._own[self._best] + self.share * predicted + beyond)
