"""A model that costs no call and leads a search: it learns from the rows so far and proposes the next ones.

The whole box is searched on it. It proposes while its points get better, and leaves the rest to the processes
of the residuals.
"""

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import SAME_POINT
from studies.calibration.descent import Descents
from studies.calibration.problem import CalibrationProblem, Evaluation

# It proposes where it expects to gain this part of the best error.
LITTLE_GAIN = 0.003
# After a round without gain a point costs its squared distance to the best row, times this part of the best
# error; the next such round raises the part by a factor, and a gain lowers it.
NEAR, NEARER = 0.3, 4.0
# Rounds without gain after which it gives up.
N_VAIN = 6
# Beside points that are known, others are drawn so far away. [1]
BESIDE = 0.05


class Leader(ABC):
    """Proposes points by residuals that it predicts.

    Attributes:
        NAME: What it is, for who watches the search.
    """

    NAME: ClassVar[str]

    def __init__(
        self, problem: CalibrationProblem, rng: np.random.Generator, *, n_looks: int, n_walks: int
    ) -> None:
        """Begin with nothing known.

        Args:
            problem: The problem.
            rng: Source of draws of its own, which leave those of the search as they are without it.
            n_looks: Points that are looked at in a round.
            n_walks: How many of the best of them are walked downhill.
        """
        p = problem.space.n_parameters
        self._problem, self._rng, self._n_looks = problem, rng, n_looks
        self._descents = Descents(problem.prior, p, n_walks)
        self._u, self._objective = np.empty((0, p)), np.empty(0)
        self._n_vain = self._n_proposed = 0
        self._nearness = 0.0

    @property
    def is_believed(self) -> bool:
        """Whether it may propose points: not after rounds without gain."""
        return self._n_vain < N_VAIN

    def note(self, answer: Evaluation) -> None:
        """Learn from rows that were asked.

        Args:
            answer: The rows; failed ones teach nothing.
        """
        good = np.isfinite(answer.objective)
        best = float(self._objective.min(initial=np.inf))
        is_gain = bool((answer.objective < (1.0 - LITTLE_GAIN) * best).any())
        if self._n_proposed:
            self._n_vain = 0 if is_gain else self._n_vain + 1
            nearer = max(NEARER * self._nearness, NEAR)
            self._nearness = self._nearness / NEARER if is_gain else nearer
        self._u = np.concatenate([self._u, answer.u[good]])
        self._objective = np.concatenate([self._objective, answer.objective[good]])
        self._keep(answer, np.flatnonzero(good))

    def propose(self, n: int) -> FloatArray | None:
        """Return the points to ask next, None where it gives up and is asked no more. Shape (n, p). [1].

        Args:
            n: Points.
        """
        if not (self.is_believed and self._learn()):
            return None
        p = self._u.shape[1]
        looks = self._rng.random((self._n_looks, p))
        rows = self._u[np.argsort(self._objective, kind="stable")]
        home, best_yet = rows[0], float(self._objective.min())
        cost = self._nearness * best_yet

        def with_distance(u: FloatArray) -> FloatArray:
            # Mean squares of the whole are those of the residuals, and the cost of the distance.
            residuals = self._residuals(u)
            m = residuals.shape[1]
            whole = [residuals / np.sqrt(m), np.sqrt(cost) * (u - home)]
            return np.asarray(np.concatenate(whole, axis=1) * np.sqrt(m + p))

        ends, values = self._descents.lowest(self._residuals, looks, rows, with_distance)
        points = np.empty((0, p))
        for end, value in zip(ends, values, strict=True):
            distance = np.abs(np.concatenate([self._u, points]) - end).max(axis=1).min()
            is_better = value < (1.0 - LITTLE_GAIN) * best_yet and distance > SAME_POINT
            if len(points) < n and is_better:
                points = np.concatenate([points, end[None]])
        if not len(points):
            return None
        beside = self._rng.uniform(-BESIDE, BESIDE, (n - len(points), p))
        self._n_proposed += 1
        return np.asarray(np.clip(np.concatenate([points, points[0] + beside]), 0.0, 1.0))

    @abstractmethod
    def _keep(self, answer: Evaluation, good: np.ndarray) -> None:
        """Keep what it learns from of the good rows, given by their positions."""

    @abstractmethod
    def _learn(self) -> bool:
        """Learn from the rows so far; return whether it explains them."""

    @abstractmethod
    def _residuals(self, u: FloatArray) -> FloatArray:
        """Return the residuals that it predicts at points (n, p). Shape (n, m). [first output's unit]."""
