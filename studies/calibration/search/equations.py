"""State equations as a search uses them: while they are believed, they propose its points."""

import numpy as np

from studies.calibration.proposer import Proposer
from studies.calibration.search.confirmation import PROMISED

# State equations are given up after so many proposals in a row that gained less than the equations erred by.
# By hand; an epidemic solved by Euler's method took 95 of 100 calls so.
VAIN_PROPOSALS = 3


class Equations:
    """The state equations that a search learns, and what their proposals have brought."""

    def __init__(self, ode: Proposer | None) -> None:
        """Begin with what learns them, None for nothing."""
        self.ode = ode
        self.has_probed = False
        # What single experiments cost, in whole simulations.
        self.n_alone = 0
        # What the last proposals erred by, as parts of the error, as long as they gained less.
        self.vain = list[float]()

    @property
    def believed(self) -> Proposer | None:
        """The equations where they propose the next point: they are known within all bounds."""
        ode = self.ode
        return ode if ode is not None and ode.is_believed and not ode.is_given_up else None

    @property
    def is_sure(self) -> bool:
        """Whether they are known exactly, and predicted a simulation that they had proposed."""
        # Equations that were given up are asked no more: a search that took them for sure simulated nothing.
        return self.believed is not None and self.believed.is_sure and self.believed.n_asked > 0

    @property
    def is_outdone(self) -> bool:
        """Whether they were given up and err by no more than what makes an answer wrong."""
        is_given_up = self.ode is not None and self.ode.is_given_up
        return is_given_up and max(self.vain, default=np.inf) <= PROMISED

    @property
    def predicted(self) -> float | None:
        """The objective that they predict at their last proposal, None without one. [unit squared]."""
        return None if self.ode is None else self.ode.predicted

    def forget_proposal(self) -> None:
        """Forget the last proposal, which is not simulated."""
        if self.ode is not None:
            self.ode.predicted = None

    def judge_proposal(self, gain: float, error: float, rest: float) -> bool:
        """Return whether they are given up: their last proposals have gained less than they err by.

        Args:
            gain: What the last one gained. [unit squared]
            error: What its objective differs by from the equations'. [unit squared]
            rest: The objective that gains are measured against. [unit squared]
        """
        # A proposal that failed shows nothing of what the equations err by.
        self.vain = [*self.vain, error / rest] if gain < error < np.inf and rest > 0.0 else []
        if self.ode is None or len(self.vain) < VAIN_PROPOSALS:
            return False
        self.ode.is_given_up = True
        return True

    @property
    def error_in_words(self) -> str:
        """Say that believed equations err by more than what makes an answer right, "" else."""
        error = 0.0 if self.believed is None else self.believed.error_at_best
        return f"differ from the best simulation by {error:.2g} of its error" if error > PROMISED else ""
