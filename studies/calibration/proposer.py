"""What a search asks of a model that is learnt from its rows, and that proposes where to simulate next."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.problem import Evaluation


class RowLearner(Protocol):
    """A model that is learnt from rows, as state equations and a hidden network are."""

    @property
    def is_believed(self) -> bool:
        """Whether points are simulated where it expects a low error."""

    def note(self, answer: Evaluation) -> None:
        """Learn from rows that were asked; failed ones teach nothing."""


class Proposer(RowLearner, Protocol):
    """A model that is exact once it is believed, of one experiment or of several; see `LearnedODE`.

    Attributes:
        predicted: The objective that was expected of the point proposed last, None once it is known or
            forgotten. [unit squared]
        n_asked: Proposed points that were simulated.
        n_alone: Simulations of single experiments.
        is_given_up: Whether the search goes on without it.
    """

    predicted: float | None
    n_asked: int
    n_alone: int
    is_given_up: bool

    @property
    def is_sure(self) -> bool:
        """Whether it matches what was simulated: more rows would add nothing."""

    @property
    def error_at_best(self) -> float:
        """How it differs from the best simulation, as a share of its squared residuals. [1]."""

    @property
    def left_out(self) -> BoolArray:
        """Which parameters it does not depend on, as far as rows show. Shape (p,)."""

    def report_to(self, think_of: Callable[[str], None]) -> None:
        """Call this from now on with what is looked at, as that may take seconds."""

    def learn_alone(self, u: FloatArray) -> int:
        """Learn from single experiments at points (n, p); return how many whole rows these are worth."""

    def unseen(self, u: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
        """Return n points where the model may do what no row has shown, given the best point (p,)."""

    def slopes(self, u: FloatArray) -> FloatArray:
        """Return the residuals' slopes at a point (p,). Shape (m, p). [unit per range]."""

    def propose(
        self, objective: FloatArray, known: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, Expansion]:
        """Return the point to ask next and what is expected of it.

        Args:
            objective: Of the rows so far, infinite where they failed. Shape (n,). [unit squared]
            known: Their points. Shape (n, p). [1]
            rng: Source of the points that are looked at.
        """
