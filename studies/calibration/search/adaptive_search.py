"""The rows of an adaptive calibration: first design, search phases, restarts, trust region and proposals.

What a search does next follows from its rows and its phase, see `AdaptiveSearch._next`: ask the first design,
search around a row, double the window, test, restart in another valley or go back to the best row, end.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.differences import difference_rows, difference_slopes
from studies.calibration.growing_rows import GrowingBasis, GrowingRows
from studies.calibration.hidden_network.search import HiddenNetwork
from studies.calibration.largest_samples import outlying_part
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.processes.groups import Part, ProcessGroups, is_refitted
from studies.calibration.processes.process import Features
from studies.calibration.recorder import Recorder
from studies.calibration.search.confirmation import least_unlikely
from studies.calibration.search.constants import SEARCH
from studies.calibration.search.ending import Confirmation, Ending, still_falling
from studies.calibration.search.expected_objective import (
    expected_objective,
    is_surely_no_better,
    is_surprised,
)
from studies.calibration.search.failures import Failures, Penalty
from studies.calibration.search.first_design import first_points
from studies.calibration.search.proposals import Surroundings, favourites, informative
from studies.calibration.search.restart import farther_along, least_excluded
from studies.calibration.search.row_choice import n_apart
from studies.calibration.search.settings import SearchSettings
from studies.calibration.search.truncated_window import TruncatedWindow
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN
from studies.calibration.state_equations.learned_ode import LearnedODE, enough_for_equations


@dataclass
class SearchPhase:
    """Rounds around one row, until they gain too little.

    Attributes:
        first: It sees the rows from this one on; 0 where it is around the best row of all.
        is_far: Whether it began in another valley.
        lowest: Its lowest objective after every round. [unit squared]
        n_idle: Rounds in a row that neither expected nor gained `ftol`.
        n_stagnant: Rounds in a row that neither expected nor gained what makes a round worth while.
    """

    first: int = 0
    is_far: bool = False
    lowest: list[float] = field(default_factory=list)
    n_idle: int = 0
    n_stagnant: int = 0


class AdaptiveSearch:
    """The rows of one calibration and its trust region."""

    def __init__(
        self,
        settings: SearchSettings,
        problem: CalibrationProblem,
        recorder: Recorder,
        rng: np.random.Generator,
        known: Evaluation | None = None,
        learned_ode: LearnedODE | None = None,
        network: HiddenNetwork | None = None,
    ) -> None:
        """Begin with what is known.

        Args:
            settings: How to search.
            problem: The parameters and what is known about them.
            recorder: Asks the model and counts.
            rng: Source of the first design and all draws.
            known: Rows that were simulated before (warm start), None for none.
            learned_ode: Learns the model's state equations, None for none.
            network: Learns a network whose states the model hides, None for none.
        """
        self._settings = settings
        self._ode, self._network = learned_ode, network
        self._p = p = problem.space.n_parameters
        self._prior = problem.prior
        self._features = Features.of(problem.space)
        self._parts = Part.parts_of(problem)
        self._recorder = recorder
        if learned_ode is not None:
            learned_ode.report_to(recorder.think_of)
        self._rng = rng
        self._u = self._unasked = np.empty((0, p))
        self._objective = np.empty(0)
        self._answers = GrowingRows(problem.measurement.n_samples)
        # By the place of the part: its residuals in the window, as coordinates.
        self._bases = dict[int, GrowingBasis]()
        self._penalty = np.empty(0)
        self._window = TruncatedWindow(problem.measurement)
        self._sensor = float(problem.measurement.uncertainty[0])
        # Slopes of the residuals beside an exact fit, once the model was asked for them.
        self._differences: FloatArray | None = None
        # What the last proposals of state equations erred by, as long as they gained less.
        self._vain = list[float]()
        # None until a search has shown whether it explains enough.
        self._was_truncated: bool | None = None
        self._has_probed = False
        # Hyperparameters of the last fit, by the place of the part.
        self._hyper = dict[int, tuple[FloatArray, ...]]()
        self._n_fitted = self._n_failures_fitted = 0
        self._penalty_expected: Penalty | None = self._prior
        self._failed_hyper: FloatArray | None = None
        self._radius = SEARCH.radius
        self._n_alone = 0
        self._phase = SearchPhase()
        self._confirmation = self._no_confirmation
        self.n_rounds = 0
        self.expected_gain = np.inf
        self._n_acting = problem.n_acting
        self._n_whole_design = n_design = settings.design_size(problem.n_acting)
        self._n_known = 0
        if known is not None and known.n:
            recorder.know(known)
            self._keep(known)
            self._n_known = known.n
            n_design = max(n_design - n_apart(known.u[np.isfinite(known.objective)]), 0)
            if not n_design:
                # Rows all over the box may show a better valley than that of the best row.
                self._radius = 1.0
        self._n_design = n_design
        # What surrogates are judged by, as far as the rows go.
        self._n_first = self._n_known + n_design

    def run(self) -> Ending:
        """Ask rows until target, tolerance or restarts in vain; return why it ended.

        Raises:
            BudgetExceeded: The budget is spent.
        """
        if self._n_design and self._believed is None:
            self._ask_first(first_points(self._n_design, self._p, self._rng))
        while True:
            try:
                move = self._next()
                if isinstance(move, Ending):
                    return move
                move()
            # Rows that no surrogate can be fitted to: other rows may show more.
            except np.linalg.LinAlgError:
                self._ask_anywhere()

    def _next(self) -> Callable[[], None] | Ending:
        """Return what is done next, or why the search ends."""
        target = self._settings.target_mse
        if target is not None and self._recorder.best_mse <= target:
            return Ending("the target is reached", converged=True)
        if target is None and self._is_outdone and not self._is_too_large:
            return self._ending_outdone
        # What equations have left of the first design is asked once they are not believed.
        if len(self._unasked) and self._believed is None:
            return self._ask_rest
        n_good = np.isfinite(self._objective).sum()
        # A process needs two rows that succeeded.
        if n_good < 2 and self._believed is None:
            return self._ask_anywhere
        if not n_good:
            return self._ask_by_equations
        if self._network is not None:
            self._recorder.think_of("a network with hidden states")
            proposed = self._network.propose(self._settings.n_parallel)
            if proposed is not None:
                return partial(self._ask, proposed)
            self._network = None
        self._adapt_window()
        if self._fits_exactly:
            return self._compare_beside if self._needs_slopes else self._ending_exactly
        if not self._phase_is_over:
            return self._search if n_good > 1 else self._ask_by_equations
        if self._is_at_best and not self._window.is_whole and self._may_double_window:
            return self._double_window
        if self._believed is not None:
            if not self._is_at_best:
                return self._turn
            beyond = self._beyond_rows(self._believed)
            if beyond is None:
                return self._ending_by_equations
            self._phase.n_idle = 0
            return beyond
        if self._has_settled:
            if not self._confirmation.is_tested:
                return self._test
            if self._may_end:
                return self._ending
        return self._turn

    @property
    def _fits_exactly(self) -> bool:
        """Whether there is nothing left to gain: every gain would be large beside an error of nearly zero."""
        if self._settings.target_mse is not None or not self._window.is_whole or self._prior is not None:
            return False
        # Of a measurement that never varies all is explained.
        return self._recorder.best_mse == 0.0 or 0.0 < self._unexplained <= SEARCH.exact

    @property
    def _needs_slopes(self) -> bool:
        """Whether the model has to be asked what it does beside an exact fit, and may be asked.

        A surrogate knows a ridge from rows that lie along it, and an exact fit comes before there are any.
        """
        is_affordable = self._settings.max_calls - self._recorder.n_calls >= 2 * self._p
        return self._believed is None and self._differences is None and is_affordable

    def _compare_beside(self) -> None:
        """Ask rows on both sides of the best one along every parameter, for the slopes there."""
        n, best = self._objective.size, int(np.argmin(self._objective))
        # So far inside that no side is cut: a one-sided difference shows a slope along a bent ridge.
        inside = np.clip(self._u[best], SEARCH.beside, 1.0 - SEARCH.beside)
        self._ask(difference_rows(inside, SEARCH.beside)[1:])
        rows = [best, *range(n, self._objective.size)]
        self._differences = difference_slopes(self._u[rows], self._residuals[rows]).T

    @property
    def _ending_exactly(self) -> Ending:
        """Why a search ends that has nothing left to gain."""
        within = math.sqrt(self._recorder.best_mse) / self._sensor
        said = f"the best simulation fits within {within:.2g} of the sensor's uncertainty (RMS)"
        return Ending(said, converged=within <= 1.0)

    @property
    def _has_settled(self) -> bool:
        """Whether around the best row of all nothing more is expected, and not for failures alone."""
        has_ended = self._is_at_best and self._phase.n_stagnant >= SEARCH.stagnant_rounds
        return has_ended and self._window.is_whole and self._has_whole_region

    @property
    def _has_whole_region(self) -> bool:
        """Whether no failures have shrunk the trust region below where bad steps end to."""
        return self._radius >= SEARCH.least_radius

    @property
    def _phase_is_over(self) -> bool:
        """Whether the search phase has converged or gains too little."""
        phase, is_at_best = self._phase, self._is_at_best
        if self._believed is not None:
            return phase.n_idle >= SEARCH.stagnant_rounds
        is_away = self._window.is_whole and not is_at_best
        if phase.n_stagnant >= (SEARCH.stagnant_rounds_away if is_away else SEARCH.stagnant_rounds):
            return True
        rounds = SEARCH.stall_rounds if is_at_best else SEARCH.stall_rounds_away
        owed = SEARCH.stall_gain if is_at_best else SEARCH.stall_gain_away
        lowest = phase.lowest
        if len(lowest) <= rounds:
            return False
        outlying = self._outlying(self._phase_row)
        return lowest[-1] - outlying > (1.0 - owed) * (lowest[-1 - rounds] - outlying)

    def _outlying(self, row: int) -> float:
        """Return the part of a row's error that is its largest samples'; gains are measured without it."""
        return outlying_part(self._window.seen(self._residuals[[row]])[0], self._sensor)

    @property
    def _phase_row(self) -> int:
        """The phase's row of the lowest objective, or the last row where it has none."""
        first = min(self._phase.first, self._objective.size - 1)
        return first + int(np.argmin(self._objective[first:]))

    def _test(self) -> None:
        """Ask where a lower error is least unlikely, all over the box; go on from what is better."""
        best = int(np.argmin(self._objective))
        here, before, outlying = self._u[best], float(self._objective[best]), self._outlying(best)
        rows, n_parallel = (self._u, np.isfinite(self._objective)), self._settings.n_parallel
        self._recorder.think_of("functions that may be lower at other points")
        process, n_before = self._fit(), self._objective.size
        self._weigh_failures(before)
        places, gains = least_unlikely(
            process, self._penalty_expected, (here, before), rows, n_parallel, self._rng, outlying=outlying
        )
        self._ask(places)
        if self._objective.min() - outlying < (1.0 - self._settings.ftol) * (before - outlying):
            self._phase = SearchPhase()
            return
        # What fails confirms nothing.
        if np.isfinite(self._objective[n_before:]).any():
            self._confirmation.note_test(gains)
        # What was learnt may show a step from the best row.
        self._phase.n_stagnant = SEARCH.stagnant_rounds - 1

    def _ask_first(self, design: FloatArray) -> None:
        """Ask a first design, round by round where state equations may take less of it."""
        n_asked, q = 0, self._settings.n_parallel
        if self._ode is not None:
            # At most as many rows' worth as points: the budget still holds a whole row afterwards.
            self._n_alone = self._ode.learn_alone(design[: self._settings.max_calls - 1])
            if self._n_alone:
                self._recorder.pay(self._n_alone)
            if self._believed is None:
                self._forget_alone()
            n_enough = min(math.ceil(enough_for_equations(self._n_acting) / q) * q, len(design))
            # Whole rounds: one with idle workers takes as long.
            n_next = math.ceil(LEAST_TO_LEARN / q) * q
            while n_asked < n_enough and not self._ode.is_sure:
                n_next = min(n_next, n_enough - n_asked)
                self._ask(design[n_asked : n_asked + n_next])
                n_asked, n_next = n_asked + n_next, q
        self._unasked = design[n_asked:]

    def _ask_rest(self) -> None:
        """Ask what state equations have left of the first design."""
        self._forget_alone()
        self._unasked, rest = self._unasked[:0], self._unasked
        self._ask(rest)

    def _forget_alone(self) -> None:
        """Do not count what was simulated in single experiments: the whole rows that follow hold it."""
        if self._ode is not None and self._n_alone:
            self._recorder.pay(-self._n_alone)
            self._n_alone = self._ode.n_alone = 0

    def _ask_by_equations(self) -> None:
        """Make a round by equations that are believed before there are two rows, which a process needs."""
        assert self._believed is not None, "they propose the point"
        point, expected = self._believed.propose(self._objective, self._u, self._rng)
        lowest = float(self._objective.min(initial=np.inf))
        rest = lowest - (self._outlying(int(np.argmin(self._objective))) if self._objective.size else 0.0)
        promise = lowest - expected.value
        if promise <= self._least_gain * rest < np.inf:
            self.expected_gain = max(promise / rest, 0.0) if rest > 0.0 else 0.0
            self._phase.n_idle += 1
            self._forget_proposal()
            return
        self._ask(point[None])
        self._phase.lowest.append(self._phase_best)

    def _ask_anywhere(self) -> None:
        """Ask a round of random rows."""
        self._ask(self._rng.random((self._settings.n_parallel, self._p)))

    def _beyond_rows(self, ode: LearnedODE) -> Callable[[], None] | None:
        """Return what may show that the model does more than equations know, None for nothing."""
        n = math.ceil(SEARCH.n_probes / self._settings.n_parallel) * self._settings.n_parallel
        is_affordable = self._settings.max_calls - self._recorder.n_calls >= n
        # Two signs of a part of the model that no row has shown (docs/notes/state-equations.md, Ranges
        # that no row has shown): an error too large for the sensor, and parameters in no equation.
        if not self._has_probed and is_affordable and (self._is_too_large or ode.left_out.any()):
            return partial(self._probe, ode, n)
        return self._ask_rest if self._is_too_large and len(self._unasked) else None

    def _probe(self, ode: LearnedODE, n: int) -> None:
        """Ask n rows where states go beyond what rows have shown, as where a valve closes."""
        self._has_probed = True
        self._ask(ode.unseen(self._u[int(np.argmin(self._objective))], n, self._rng))

    @property
    def _believed(self) -> LearnedODE | None:
        """The state equations where they propose the next point: they are known in the whole box."""
        is_believed = self._ode is not None and self._ode.is_believed and not self._ode.is_given_up
        return self._ode if is_believed else None

    @property
    def _is_sure(self) -> bool:
        """Whether state equations are known exactly, and predicted a row that they had proposed."""
        # Equations that were given up are asked no more: a search that took them for sure simulated nothing.
        return self._believed is not None and self._believed.is_sure and self._believed.n_asked > 0

    @property
    def _ftol(self) -> float:
        """Relative gain that is too small to go on; with a target, none is."""
        return self._settings.ftol if self._settings.target_mse is None else 0.0

    @property
    def _least_gain(self) -> float:
        """Relative gain that is worth a round; exact equations show when there is none left."""
        return max(self._ftol, SEARCH.stagnant) if self._is_sure else self._ftol

    def _adapt_window(self) -> None:
        """Truncate the window, once, of a search that explains too little; double it once it is explained."""
        if self._believed is not None:
            # State equations predict the whole trajectory.
            while not self._window.is_whole:
                self._double_window()
            return
        n_judged = self._n_first + self._n_whole_design
        if self._was_truncated is None and self._objective.size >= n_judged and not self._is_falling:
            self._was_truncated = self._unexplained > SEARCH.unexplained
            if self._was_truncated:
                self._window.shorten(to_features=self._switches)
                self._begin_again()
        while not self._window.is_whole and self._unexplained <= SEARCH.explained:
            self._double_window()

    @property
    def _is_falling(self) -> bool:
        """Whether the last rounds have brought much."""
        n_last = min(SEARCH.falling_rounds * self._settings.n_parallel, self._n_whole_design)
        return bool(self._objective.min() < SEARCH.falling * self._objective[:-n_last].min())

    @property
    def _may_double_window(self) -> bool:
        """Whether the window is nearly explained, or a restart has not explained it."""
        return self._confirmation.n_restarts > 0 or self._unexplained <= SEARCH.nearly_explained

    def _double_window(self) -> None:
        """Double the window and go on from the row that is best then."""
        self._window.double()
        self._begin_again()

    def _begin_again(self) -> None:
        """Judge all rows by the present window and begin a search phase at the best."""
        self._objective, self._bases, self._n_fitted = self._objective[:0], {}, 0
        self._judge()
        self._confirmation = self._no_confirmation
        self._phase, self._radius = SearchPhase(), SEARCH.radius

    @property
    def _no_confirmation(self) -> Confirmation:
        """Tests and restarts before any was made."""
        return Confirmation(n_owed=SEARCH.restarts_owed_to_one if self._p == 1 else SEARCH.restarts_owed)

    def _judge(self) -> None:
        """Judge the rows that were not judged by the present window."""
        n = len(self._objective)
        error = np.mean(self._window.seen(self._residuals[n:]) ** 2, axis=1)
        penalty = self._penalty[n:]
        judged = np.where(np.isfinite(penalty), error + penalty, np.inf)
        self._objective = np.concatenate([self._objective, judged])

    @property
    def _unexplained(self) -> float:
        """Share of a measured variance that the best row leaves unexplained. [1]."""
        return self._window.unexplained(self._residuals[int(np.argmin(self._objective))])

    def _search(self) -> None:
        """Make one round of a search phase."""
        process, phase = self._fit(), self._phase
        if phase.first == self._objective.size:
            self._recorder.think_of("another valley")
            self._weigh_failures(float(self._objective.min()))
            self._ask(self._restart_points(process))
            phase.lowest.append(self._phase_best)
            return
        # A phase whose rows have all failed goes on from the best row.
        first = phase.first if np.isfinite(self._phase_best) else 0
        best = first + int(np.argmin(self._objective[first:]))
        centre, lowest = self._u[best], float(self._objective[best])
        self._weigh_failures(lowest)
        points, expected = self._propose(process, centre)
        outlying = self._outlying(best)
        promise, rest = lowest - expected.value, lowest - outlying
        share = promise / rest if rest > 0.0 else 0.0
        if self._is_sure and promise <= self._least_gain * rest:
            # The equations are exact, so that rows add nothing: the optimum is only searched for again.
            self.expected_gain = max(share, 0.0)
            phase.n_idle += 1
            self._forget_proposal()
            return
        is_settled = self._confirmation.n_tested and self._has_whole_region and self._believed is None
        if is_settled and self._is_at_best and promise <= self._ftol * rest:
            # Nothing that was asked since the first test has changed what is expected here.
            self.expected_gain = share
            phase.n_idle += 1
            phase.n_stagnant += 1
            return
        if phase.is_far and not self._is_at_best:
            home = int(np.argmin(self._objective))
            is_end = np.abs(points[0] - centre).max() < SEARCH.at_the_edge * self._radius
            is_end |= np.abs(points[0] - self._u[home]).max() < SEARCH.came_back
            # In another valley, no call is spent where its bottom is excluded already.
            best_of_all = float(self._objective[home]), self._outlying(home)
            if is_end and is_surely_no_better(process, points[0], expected, *best_of_all):
                self._turn()
                return
        predicted = self._ode.predicted if self._ode is not None else None
        asked = self._objective.size
        self._ask(points)
        # The end of the budget may have cut off all points but the first ones.
        found = self._objective[asked:]
        gain = max(lowest - self._phase_best, 0.0)
        self._resize(points[0] - centre, found, gain, promise)
        self.expected_gain = share
        stagnant = max(self._ftol, SEARCH.stagnant if self._window.is_whole else SEARCH.stagnant_in_window)
        # A round is in vain where neither found nor expected gains are left.
        hope = max(gain, promise)
        if predicted is None:
            predicted = self._expand(process, points[0], SEARCH.caution).value
        # A surrogate that errs at its favourite point ends no
        # search (docs/notes/adaptive-search.md, Truncated windows).
        if self._believed is not None:
            self._note_proposal(gain, abs(float(found[0]) - predicted), rest)
        values = (float(found[0]), predicted, expected.value, lowest)
        if is_surprised(*(value - outlying for value in values)):
            hope = np.inf
        phase.n_idle = phase.n_idle + 1 if hope <= self._ftol * rest else 0
        phase.n_stagnant = phase.n_stagnant + 1 if hope <= stagnant * rest else 0
        phase.lowest.append(self._phase_best)

    def _note_proposal(self, gain: float, error: float, rest: float) -> None:
        """Give up state equations whose proposals have gained less than they err by.

        Args:
            gain: What the last one gained. [unit squared]
            error: What its objective differs by from the equations'. [unit squared]
            rest: What gains are measured against. [unit squared]
        """
        # A proposal that failed shows nothing of what the equations err by.
        self._vain = [*self._vain, error / rest] if gain < error < np.inf and rest > 0.0 else []
        if len(self._vain) >= SEARCH.vain_proposals and self._ode is not None:
            self._ode.is_given_up = True
            # What is left to gain is less than what the equations err by, unless these err at other points.
            self._phase = SearchPhase()

    @property
    def _is_outdone(self) -> bool:
        """Whether the equations were given up and err by no more than what makes an answer wrong."""
        is_given_up = self._ode is not None and self._ode.is_given_up
        return is_given_up and max(self._vain, default=np.inf) <= SEARCH.promised

    @property
    def _phase_best(self) -> float:
        """The phase's lowest objective so far."""
        return float(self._objective[self._phase.first :].min(initial=np.inf))

    @property
    def _is_at_best(self) -> bool:
        """Whether the phase is around the best row of all."""
        return self._phase_best <= float(self._objective.min())

    @property
    def _is_too_large(self) -> bool:
        """Whether the best error is above the misfit threshold."""
        threshold, best_mse = self._settings.misfit_threshold, self._recorder.best_mse
        # One wrong sample says nothing against the fit of all others.
        return (
            threshold is not None
            and best_mse > threshold
            and best_mse - self._outlying(int(np.argmin(self._objective))) > threshold
        )

    @property
    def _is_tried(self) -> bool:
        """Whether restarts, or fewer of them and tests that promise no gain, were in vain."""
        known = self._confirmation
        is_vain = known.has_looked and known.is_tested and not known.is_promising
        return known.n_restarts >= SEARCH.most_restarts or (is_vain and not self._switches)

    @property
    def _switches(self) -> bool:
        """Whether the model switches at times that depend on its parameters, by rows that lie apart."""
        first = self._is_sane[: self._n_first]
        return self._window.switches(self._residuals[: first.size][first][-SEARCH.n_compared :])

    @property
    def _may_end(self) -> bool:
        """Whether the restarts that are owed were made and the best row is accepted."""
        # With a target the search goes on, however little is expected.
        if self._settings.target_mse is not None or (self._is_too_large and not self._is_tried):
            return False
        # Where another number of switchings may be right, more restarts find it now and then.
        known = self._confirmation
        return known.n_restarts >= SEARCH.most_restarts if self._switches else known.has_looked

    @property
    def _ending(self) -> Ending:
        """Why a search by processes ends that expects nothing more."""
        return self._confirmation.ending(switches=self._switches, is_too_large=self._is_too_large)

    @property
    def _ending_by_equations(self) -> Ending:
        """Why a search by state equations ends that expects nothing more."""
        target = self._settings.target_mse
        little = f"a gain of less than {self._least_gain:g} of the error"
        missed = "" if target is None else f"; the target of {target:g} is missed"
        nowhere = f", and nowhere {SEARCH.wanted:g} times the error" if self._is_too_large else ""
        beyond = f", but {self._ode_error}" if self._ode_error else ""
        reason = f"the state equations expect {little}{nowhere}{missed}{beyond}"
        return Ending(reason, converged=(target is None or self._is_sure) and not beyond)

    @property
    def _ending_outdone(self) -> Ending:
        """Why a search ends whose equations know the optimum as well as they can."""
        n, error = len(self._vain), max(self._vain)
        return Ending(
            f"the last {n} simulations at the optimum of the state equations gained less than the equations "
            f"err by ({error:.2g} of the error): at most {SEARCH.promised:g} of it could still be gained",
            converged=True,
        )

    @property
    def _ode_error(self) -> str:
        """Say that believed state equations err by more than what makes an answer right, "" else."""
        if self._believed is None or self._believed.error_at_best <= SEARCH.promised:
            return ""
        return f"differ from the best simulation by {self._believed.error_at_best:.2g} of its error"

    @property
    def left(self) -> str:
        """What may be left to gain where a search stopped, and what the next round would try."""
        if not np.isfinite(self._recorder.best_mse):
            return ""
        if self._ode_error:
            return f"the state equations {self._ode_error}; --no-state-equations searches without them"
        if len(self._unasked) or self._objective.size < self._n_first:
            return "the first design is not finished, and the next round would go on with it"
        if self._is_too_large and self._is_tried:
            return "a deeper valley may be left, or the model lacks something; another seed begins anew"
        if not self._window.is_whole:
            return (
                "so far only the first part of the trajectories is fitted; the next round would go on with it"
            )
        if self._is_at_best and not self._has_whole_region:
            return "simulations around the best point fail; the next round would begin away from it"
        if self._confirmation.n_tested or self._has_settled:
            return self._confirmation.still_owed(self._settings.ftol)
        n = min(SEARCH.stall_rounds * self._settings.n_parallel, self._objective.size - 1)
        before = float(self._objective[: self._objective.size - n].min())
        gained = 1.0 - float(self._objective.min()) / before if np.isfinite(before) and before > 0.0 else 1.0
        return still_falling(n, gained, self.expected_gain)

    @property
    def is_flat(self) -> BoolArray:
        """On which parameters the error hardly depends around the best row, over all of their ranges."""
        if self._ode is not None and self._ode.is_sure:
            return self._ode.left_out
        process = self._last_process
        if process is None:
            return np.zeros(self._p, dtype=np.bool_)
        best = int(np.argmin(self._objective))
        across = np.tile(self._u[best], (self._p, SEARCH.n_across, 1))
        across[np.arange(self._p), :, np.arange(self._p)] = np.linspace(0.0, 1.0, SEARCH.n_across)
        errors = process.errors(across.reshape(-1, self._p)).reshape(self._p, SEARCH.n_across)
        rest = self._objective[best] - self._outlying(best)
        return np.asarray(np.ptp(errors, axis=1) <= SEARCH.flat * rest)

    @property
    def slopes(self) -> FloatArray | None:
        """Slopes of the residuals at the best row, in an orthonormal basis of p residuals.

        A slope that rows leave open counts as large as it may be: what has none has been seen to have none.

        Returns:
            Shape (p, p), None where too little is known of the model. [first output's unit per range]
        """
        best = self._u[int(np.argmin(self._objective))]
        if self._believed is not None:
            slopes = self._believed.slopes(best)
            # R alone has the slopes' singular values and products, in p rows.
            return np.asarray(np.linalg.qr(slopes, mode="r")) if np.isfinite(slopes).all() else None
        if self._differences is not None:
            return np.asarray(np.linalg.qr(self._differences, mode="r"))
        if self._fits_exactly:
            return None
        process = self._last_process
        if process is None:
            return None
        # The Hessian is 2 J' J / m, with what the variance adds: its root is J but for a rotation, in p rows.
        hessian = 0.5 * self._residuals.shape[1] * process.expand(best, 1.0).hessian
        if not np.isfinite(hessian).all():
            return None
        squares, axes = np.linalg.eigh(hessian)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0))[:, None] * axes.T)

    @cached_property
    def _last_process(self) -> ProcessGroups | None:
        """The surrogate of all rows, once there are no more; None where they are a first design or less."""
        is_enough = self._window.is_whole and self._objective.size > self._n_first
        if not is_enough or not 0.0 < self._objective.min() < np.inf or self._is_sane.sum() < 2:
            return None
        try:
            return self._fit()
        except np.linalg.LinAlgError:
            return None

    def _forget_proposal(self) -> None:
        """Forget the last point of the state equations, which is not simulated."""
        if self._ode is not None:
            self._ode.predicted = None

    def _turn(self) -> None:
        """End a search phase: restart away from the best row, or go back to it."""
        self._forget_proposal()
        if not self._is_at_best:
            self._phase, self._radius = SearchPhase(), max(self._radius, SEARCH.least_radius)
            return
        self._confirmation.n_restarts += 1
        # A valley in which the error still falls is followed; from its bottom the search restarts far away.
        is_far = self._phase.n_stagnant >= SEARCH.stagnant_rounds
        self._phase, self._radius = SearchPhase(self._objective.size, is_far), SEARCH.radius

    def _ask(self, u: FloatArray) -> None:
        """Simulate rows, as many as the budget still holds, and keep what they answer."""
        left = self._settings.max_calls - self._recorder.n_calls
        u = np.round(u, SEARCH.decimals)
        # One row at least: beyond the budget it raises BudgetExceeded, which ends the search.
        answer = self._recorder.evaluate(u[: max(left, 1)])
        self.n_rounds += math.ceil(answer.n / self._settings.n_parallel)
        self._keep(answer)
        if self._window.is_whole:
            best = int(np.argmin(self._objective))
            self._confirmation = self._confirmation.after(float(self._objective[best]), self._outlying(best))

    def _keep(self, answer: Evaluation) -> None:
        """Take rows among those that the search learns from."""
        self._u = np.concatenate([self._u, answer.u])
        self._answers.add(answer.residuals)
        penalty = np.full(answer.n, np.inf)
        good = np.isfinite(answer.mse)
        # The prior's part, apart from the error: a window changes the error alone.
        penalty[good] = answer.objective[good] - answer.mse[good]
        self._penalty = np.concatenate([self._penalty, penalty])
        self._judge()
        if self._ode is not None:
            self._ode.note(answer)
        if self._network is not None:
            self._network.note(answer)

    @property
    def _residuals(self) -> FloatArray:
        """Residuals of all rows. Shape (n, m). [first output's unit]."""
        return self._answers.rows

    def _fit(self) -> ProcessGroups:
        good, fitted = self._is_sane, list[ProcessGroups]()
        output_of = self._window.seen_of
        # Rows of a warm start do not count: new ones matter as much as without them.
        n_new = int(good[self._n_known :].sum())
        refits = is_refitted(n_new, self._n_fitted)
        if refits:
            self._n_fitted = n_new
        for place, part in enumerate(self._parts):
            is_its = np.isin(output_of, part.outputs)
            # A truncated window may have nothing of an experiment.
            if not is_its.any():
                continue
            basis = self._bases.setdefault(place, GrowingBasis(int(is_its.sum())))
            basis.add(self._window.seen(self._residuals[basis.n_rows :])[:, is_its])
            process = ProcessGroups.fit(
                part.features,
                self._u[good],
                basis.coordinates[good],
                self._hyper.get(place, ()),
                # A search in a truncated window has to explain large components first.
                balance=not self._was_truncated,
                # Beside hundreds of rows from all over the box,
                # errors near the best row would pass for noise.
                n_noisy=int(good[: self._n_known].sum()) if self._n_known else None,
                n_residuals=int(is_its.sum()),
                refits=refits,
            )
            self._hyper[place] = process.hyper
            fitted.append(process)
        return ProcessGroups.joined(fitted)

    def _weigh_failures(self, objective: float) -> None:
        """Learn where rows fail, and let that weigh as much as an objective. [unit squared]."""
        failed = ~np.isfinite(self._objective)
        if not failed.any():
            return
        refits = is_refitted(failed.size, self._n_failures_fitted)
        if refits:
            self._n_failures_fitted = failed.size
        guess = self._failed_hyper
        known = Failures.fit(
            self._features, self._u, failed, self._prior, guess, scale=objective, refits=refits
        )
        self._failed_hyper, self._penalty_expected = known.process.hyper, known

    @property
    def _is_sane(self) -> BoolArray:
        """Which rows a surrogate learns from: beside diverged simulations all others would seem alike."""
        finite = np.isfinite(self._objective)
        design = self._objective[: self._n_first]
        design = design[np.isfinite(design)]
        if not design.size:
            return finite
        sane = finite & (self._objective <= SEARCH.diverged * np.quantile(design, 0.25))
        return sane if sane.sum() >= 2 else finite

    def _expand(self, process: ProcessGroups, u: FloatArray, caution: float) -> Expansion:
        return expected_objective(process, self._penalty_expected, u, caution)

    def _restart_points(self, process: ProcessGroups) -> FloatArray:
        """Return where a restarted phase begins, one point for each parallel row."""
        expand, shape = partial(self._expand, process), (self._settings.n_parallel, self._p)
        if self._phase.is_far:
            best = int(np.argmin(self._objective))
            return least_excluded(
                expand, float(self._objective[best]), shape, self._rng, outlying=self._outlying(best)
            )
        return farther_along(expand, shape, self._rng)

    def _propose(self, process: ProcessGroups, centre: FloatArray) -> tuple[FloatArray, Expansion]:
        """Return the points to simulate next, the favourite first, and what is expected of it."""
        # In another valley, descents from random starts would lead back to the best row.
        n_descents = 1 if self._phase.is_far and not self._is_at_best else SEARCH.n_descents
        penalty, radius, n_parallel = self._penalty_expected, self._radius, self._settings.n_parallel
        surroundings = Surroundings(process, penalty, centre, radius, self._u, n_descents)
        if self._believed is not None:
            point, favourite = self._believed.propose(self._objective, self._u, self._rng)
            points = point[None]
        else:
            points, favourite = favourites(surroundings, (n_parallel + 1) // 2, self._rng)
        if len(points) < n_parallel:
            n_more = n_parallel - len(points)
            points = np.concatenate([points, informative(surroundings, points, favourite, n_more, self._rng)])
        return points, favourite

    def _resize(self, step: FloatArray, found: FloatArray, gain: float, expected: float) -> None:
        """Widen or shrink the trust region by what the last round has brought.

        Args:
            step: From the centre to the favourite. Shape (p,). [1]
            found: Objectives of the round. Shape (q,). [unit squared]
            gain: How much lower the least of them is than the centre's. [unit squared]
            expected: The gain that the favourite promised. [unit squared]
        """
        if not np.isfinite(found).any():
            self._radius = max(self._radius * SEARCH.shrink_after_failure, SEARCH.smallest_radius)
        elif gain < SEARCH.bad_step * expected:
            # A radius that failures have made smaller than the
            # least one is left as it is: no bad step widens it.
            self._radius = max(self._radius * SEARCH.shrink, min(self._radius, SEARCH.least_radius))
        # A good step inside of the region shows no need of a wider one.
        elif gain > SEARCH.good_step * expected and np.abs(step).max() > SEARCH.at_the_edge * self._radius:
            self._radius = min(self._radius * SEARCH.grow, 1.0)
