"""All that changes during a search, as records of their own, and how simulations come into them."""

import math
from collections.abc import Sequence

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.leader import Leader
from studies.calibration.problem import Evaluation
from studies.calibration.proposer import Proposer
from studies.calibration.recorder import Recorder
from studies.calibration.search.confirmation import (
    MOST_RESTARTS,
    RESTARTS_OWED,
    RESTARTS_OWED_TO_ONE,
    Confirmation,
)
from studies.calibration.search.equations import Equations
from studies.calibration.search.first_design import DECIMALS
from studies.calibration.search.row_choice import n_apart
from studies.calibration.search.rows import Rows
from studies.calibration.search.search_phase import STAGNANT, SearchPhase
from studies.calibration.search.settings import SearchSettings
from studies.calibration.search.surrogates import Surrogates
from studies.calibration.search.trust_region import TrustRegion

# Share of the measured variance that an exact fit leaves at most
# (docs/notes/adaptive-search.md, Convergence).
EXACT_FIT = 1e-8


class SearchState:
    """A search: its settings, what it asks, and what it knows; moves change it."""

    def __init__(
        self,
        settings: SearchSettings,
        recorder: Recorder,
        rng: np.random.Generator,
        known: Evaluation | None = None,
        learned_ode: Proposer | None = None,
        leaders: Sequence[Leader] = (),
    ) -> None:
        """Begin with what is known.

        Args:
            settings: How to search.
            recorder: Asks the problem's model and counts.
            rng: Source of the first design and all draws.
            known: Rows that were simulated before (warm start), None for none.
            learned_ode: Learns the model's state equations, None for none.
            leaders: Lead the search one after the other, before the processes do.
        """
        problem = recorder.problem
        p = problem.space.n_parameters
        self.settings, self.recorder, self.rng = settings, recorder, rng
        self.phase, self.region = SearchPhase(), TrustRegion()
        self.confirmation = Confirmation(n_owed=RESTARTS_OWED_TO_ONE if p == 1 else RESTARTS_OWED)
        self.surrogates, self.equations, self.leaders = (
            Surrogates(problem),
            Equations(learned_ode),
            [*leaders],
        )
        if learned_ode is not None:
            learned_ode.report_to(recorder.think_of)
        # Points of the first design that equations have left, and slopes
        # beside an exact fit, once the model was asked for them.
        self.unasked: FloatArray = np.empty((0, p))
        self.differences: FloatArray | None = None
        self.n_rounds = 0
        self.expected_gain = np.inf
        n_design = self.n_whole_design
        if known is None or not known.n:
            self.rows = Rows(problem, 0, n_design)
            return
        recorder.know(known)
        n_design = max(n_design - n_apart(known.u[np.isfinite(known.objective)]), 0)
        self.rows = Rows(problem, known.n, n_design)
        self.learn(known)
        if not n_design:
            # Rows from everywhere may show a better local minimum than that of the best one.
            self.region = TrustRegion(1.0)

    def ask(self, u: FloatArray) -> None:
        """Simulate points (n, p), as many as the budget still holds, and learn from them.

        Raises:
            BudgetExceeded: The budget is spent.
        """
        # One at least: beyond the budget it raises BudgetExceeded, which ends the search.
        answer = self.recorder.evaluate(np.round(u, DECIMALS)[: max(self.n_left, 1)])
        self.n_rounds += math.ceil(answer.n / self.settings.n_parallel)
        self.learn(answer)
        if self.rows.window.is_whole:
            self.confirmation = self.confirmation.after(self.rows.best())

    def learn(self, answer: Evaluation) -> None:
        """Take simulations among those that the search learns from."""
        self.rows.add(answer)
        for learner in (self.equations.ode, *self.leaders):
            if learner is not None:
                learner.note(answer)

    def stay(self, expected_gain: float) -> None:
        """Make a round without a simulation: none is worth its call. [1]."""
        self.expected_gain = expected_gain
        self.phase.n_idle += 1
        self.equations.forget_proposal()

    def begin_again(self) -> None:
        """Judge all simulations by a window that has changed, and begin a search phase at the best."""
        self.surrogates.forget_window()
        self.rows.judge_again()
        self.confirmation = Confirmation(n_owed=self.confirmation.n_owed)
        self.phase, self.region = SearchPhase(), TrustRegion()

    @property
    def n_left(self) -> int:
        """Calls that the budget still holds."""
        return self.settings.max_calls - self.recorder.n_calls

    @property
    def n_whole_design(self) -> int:
        """Points of a first design without a warm start."""
        return self.settings.design_size(self.recorder.problem.n_acting)

    @property
    def ftol(self) -> float:
        """Relative gain that is too small to go on; with a target, none is. [1]."""
        return self.settings.ftol if self.settings.target_mse is None else 0.0

    @property
    def least_gain(self) -> float:
        """Relative gain that is worth a round; exact equations show when there is none left. [1]."""
        return max(self.ftol, STAGNANT) if self.equations.is_sure else self.ftol

    @property
    def phase_best(self) -> float:
        """The search phase's lowest objective so far. [unit squared]."""
        return self.rows.lowest(self.phase.first)

    @property
    def is_at_best(self) -> bool:
        """Whether the search phase is around the best simulation of all."""
        return self.phase_best <= self.rows.lowest()

    @property
    def has_settled(self) -> bool:
        """Whether around the best simulation nothing more is expected, and not for failures alone."""
        has_ended = self.is_at_best and self.phase.has_settled
        return has_ended and self.rows.window.is_whole and self.region.is_whole

    @property
    def is_too_large(self) -> bool:
        """Whether the best error is above the misfit threshold."""
        threshold, best_mse = self.settings.misfit_threshold, self.recorder.best_mse
        # One wrong sample says nothing against the fit of all others.
        return (
            threshold is not None
            and best_mse > threshold
            and best_mse - self.rows.best().outlying > threshold
        )

    @property
    def is_tried(self) -> bool:
        """Whether restarts, or fewer of them and tests that promise no gain, were in vain."""
        known = self.confirmation
        is_vain = known.has_looked and known.is_tested and not known.is_promising
        return known.n_restarts >= MOST_RESTARTS or (is_vain and not self.rows.switches)

    @property
    def may_end(self) -> bool:
        """Whether the restarts that are owed were made and the best simulation is accepted."""
        # With a target the search goes on, however little is expected.
        if self.settings.target_mse is not None or (self.is_too_large and not self.is_tried):
            return False
        # Where another number of switchings may be right, more restarts find it now and then.
        known = self.confirmation
        return known.n_restarts >= MOST_RESTARTS if self.rows.switches else known.has_looked

    @property
    def fits_exactly(self) -> bool:
        """Whether there is nothing left to gain: every gain would be large beside an error of nearly zero."""
        has_other_aim = self.settings.target_mse is not None or self.recorder.problem.prior is not None
        if has_other_aim or not self.rows.window.is_whole:
            return False
        # Of a measurement that never varies all is explained.
        return self.recorder.best_mse == 0.0 or 0.0 < self.rows.unexplained <= EXACT_FIT
