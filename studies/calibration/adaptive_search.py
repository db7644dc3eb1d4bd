"""The rows of an adaptive calibration: first design, legs of a search, trust region and proposals."""

import math
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.confirmation import least_unlikely
from studies.calibration.elsewhere import EXCLUDED, WANTED, farther_along, least_excluded
from studies.calibration.ending import (
    N_RESTARTS_DOUBTED,
    PROMISED,
    Confirmation,
    Ending,
    still_falling,
    too_large,
)
from studies.calibration.expected_objective import expected_objective, is_surely_no_better, is_surprised
from studies.calibration.failures import Failures, Penalty
from studies.calibration.first_design import latin_hypercube
from studies.calibration.horizon import CLEAR, LOST, UNDERSTOOD, Horizon
from studies.calibration.known_rows import missing_of_design
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.process_groups import ProcessGroups
from studies.calibration.proposals import Surroundings, liked, telling
from studies.calibration.recorder import Recorder
from studies.calibration.residual_process import Expansion, Features
from studies.calibration.state_equations import LEAST_TO_LEARN
from studies.calibration.state_guide import StateGuide, enough_for_equations

if TYPE_CHECKING:
    from studies.calibration.adaptive import Adaptive

# Points are rounded to this many decimals of the unit cube: should the last bits of the linear algebra differ
# from run to run, the rows that are simulated do not, and a store of simulations finds them again.
DECIMALS = 5

GOOD_STEP, BAD_STEP, AT_THE_EDGE = 0.5, 0.1, 0.9
GROW, SHRINK, SHRINK_AFTER_FAILURE = 1.5, 0.7, 0.5
LEAST_RADIUS = 1e-4
# Relative gain that a leg elsewhere owes in half of `stall_rounds`.
OWED_ELSEWHERE = 0.2
# A round is dull below this relative gain, expected and found. So many end a leg at a bottom that is known,
# or in a beginning, which need not be understood to the end.
DULL, DULL_IN_A_BEGINNING, DULL_ROUNDS = 1e-4, 0.1, 2
# A leg elsewhere whose next point is so near the best row has come back.
AT_HOME = 0.1
# A row so many times worse than most of the first design tells of a simulation that has diverged.
ABSURD = 1e6
# A search whose best error falls by this factor within so many rounds is not lost.
FALLING, FALLING_ROUNDS = 0.5, 3
# A best row that leaves no more than this share of the measured variance fits exactly: each round would gain
# most of an error of nearly zero.
EXACT = 1e-8
# A parameter whose error, at so many values across its range, varies by less than this part has no effect.
N_ACROSS, FLAT = 9, 1e-3
# Rows that are asked where laws may act that no row has shown, before equations that may not be all end it.
N_PROBES = 4


class AdaptiveSearch:
    """The rows of one calibration and its trust region."""

    def __init__(
        self,
        settings: "Adaptive",
        problem: CalibrationProblem,
        recorder: Recorder,
        rng: np.random.Generator,
        known: Evaluation | None = None,
        guide: StateGuide | None = None,
    ) -> None:
        """Begin with what is known.

        Args:
            settings: How to search.
            problem: The parameters and what is known about them.
            recorder: Asks the model and counts.
            rng: Source of the first design and all draws.
            known: Rows that somebody else has paid for, None for none.
            guide: Learns the model's state equations, None for none.
        """
        self._settings = settings
        self._guide = guide
        self._p = p = problem.space.n_parameters
        self._prior = problem.prior
        self._features = Features.of(problem.space)
        self._recorder = recorder
        self._rng = rng
        self._u = self._unasked = np.empty((0, p))
        self._objective = np.empty(0)
        self._residuals = np.empty((0, 0))
        self._penalty = np.empty(0)
        self._horizon = Horizon(problem.measurement)
        self._is_judged = False
        self._was_lost = False
        self._has_probed = False
        self._hyper: tuple[FloatArray, ...] = ()
        self._penalty_expected: Penalty | None = self._prior
        self._failed_hyper: FloatArray | None = None
        self._radius = settings.radius
        # A leg of the search sees the rows from `first` on; its lowest objectives after every round.
        self._first = 0
        self._leg: list[float] = []
        self._idle = self._dull = 0
        self._confirmation = Confirmation(settings.n_elsewhere)
        self._is_far = False
        self.n_rounds = 0
        self.expected_gain = np.inf
        self._n_known, self._n_design = 0, settings.design_size(p)
        if known is not None and known.n:
            recorder.know(known)
            self._keep(known)
            self._n_known = known.n
            self._n_design = missing_of_design(known, self._n_design)
            if not self._n_design:
                # What others have asked all over the box may tell of a better valley than its best row's.
                self._radius = 1.0

    def run(self) -> Ending:
        """Ask rows until target, tolerance or restarts in vain; return why it ended.

        Raises:
            BudgetExceeded: The budget is spent.
        """
        settings = self._settings
        if self._n_design and not self._is_guided:
            design = latin_hypercube(self._n_design, self._p, self._rng)
            design = settings.margin + (1.0 - 2.0 * settings.margin) * design
            self._ask_first(design)
        while True:
            if settings.target_mse is not None and self._recorder.best_mse <= settings.target_mse:
                return Ending("the target is reached", converged=True)
            if len(self._unasked) and not self._is_guided:
                self._ask_rest()
                continue
            if np.isfinite(self._objective).sum() < 2:
                self._ask(self._rng.random((settings.n_parallel, self._p)))
                continue
            self._look_as_far_as_understood()
            if self._fits_exactly:
                return Ending(
                    f"the best simulation leaves {EXACT:g} of the measured variance or less", converged=True
                )
            if self._leg_is_over():
                is_clear = self._unexplained <= CLEAR or self._confirmation.n_restarts >= settings.n_elsewhere
                if not self._horizon.is_whole and self._is_home and is_clear:
                    self._look_further()
                    continue
                if self._is_home and self._is_guided and self._idle:
                    if not self._asks_unseen():
                        return self._ending
                    self._idle = 0
                    continue
                if self._has_settled and not self._is_guided:
                    if not self._confirmation.is_tested:
                        self._test()
                        continue
                    if self._may_end:
                        return self._ending
                self._turn()
            self._step()

    @property
    def _fits_exactly(self) -> bool:
        """Whether there is nothing left to gain: every gain would be large beside an error of nearly zero."""
        if self._settings.target_mse is not None or not self._horizon.is_whole or self._prior is not None:
            return False
        # Of a measurement that never varies all is explained.
        return self._recorder.best_mse == 0.0 or 0.0 < self._unexplained <= EXACT

    @property
    def _has_settled(self) -> bool:
        """Whether around the best row of all nothing more is expected, and not for failures alone."""
        return (
            self._is_home and self._horizon.is_whole and self._dull >= DULL_ROUNDS and self._has_whole_region
        )

    @property
    def _has_whole_region(self) -> bool:
        """Whether no failures have shrunk the trust region below where bad steps end to."""
        return self._radius >= self._settings.least_radius

    def _test(self) -> None:
        """Ask where a lower error is least unlikely, all over the box; go on from what is better."""
        best = int(np.argmin(self._objective))
        here, before = self._u[best], float(self._objective[best])
        rows, n_parallel = (self._u, np.isfinite(self._objective)), self._settings.n_parallel
        process, n_before = self._fit(), self._objective.size
        self._weigh_failures(before)
        places, gains = least_unlikely(
            process, self._penalty_expected, (here, before), rows, n_parallel, self._rng
        )
        self._ask(places)
        if self._objective.min() < (1.0 - self._settings.ftol) * before:
            self._first, self._leg, self._idle, self._dull = 0, [], 0, 0
            return
        # What fails confirms nothing.
        if np.isfinite(self._objective[n_before:]).any():
            self._confirmation.note_test(gains)
        # What was learnt may show a step from the best row.
        self._dull = DULL_ROUNDS - 1

    def _ask_first(self, design: FloatArray) -> None:
        """Ask a first design, round by round where state equations may take less of it."""
        n_asked, q = 0, self._settings.n_parallel
        if self._guide is not None:
            n_enough = min(math.ceil(enough_for_equations(self._p) / q) * q, len(design))
            n_next = math.ceil(LEAST_TO_LEARN / q) * q
            while n_asked < n_enough and not self._guide.is_sure:
                n_next = min(n_next, n_enough - n_asked)
                self._ask(design[n_asked : n_asked + n_next])
                n_asked, n_next = n_asked + n_next, q
        self._unasked = design[n_asked:]

    def _ask_rest(self) -> None:
        """Ask what state equations have left of the first design."""
        self._unasked, rest = self._unasked[:0], self._unasked
        self._ask(rest)

    def _asks_unseen(self) -> bool:
        """Ask for what has happened in no row so far, as a valve that closes: it may fit better.

        Returns:
            Whether there was anything to ask.
        """
        guide = self._guide
        if guide is None or not guide.is_believed:
            return False
        n = math.ceil(N_PROBES / self._settings.n_parallel) * self._settings.n_parallel
        is_affordable = self._settings.max_calls - self._recorder.n_calls >= n
        if not self._has_probed and is_affordable and (self._is_too_large or guide.left_out.any()):
            self._has_probed = True
            best = self._u[int(np.argmin(self._objective))]
            self._ask(guide.unseen(best, n, self._rng))
            return True
        if self._is_too_large and len(self._unasked):
            self._ask_rest()
            return True
        return False

    @property
    def _is_guided(self) -> bool:
        """Whether state equations say where to ask next: they know the whole box."""
        return self._guide is not None and self._guide.is_believed

    @property
    def _is_sure(self) -> bool:
        """Whether state equations are known exactly, and a row that they proposed was as they told."""
        return self._guide is not None and self._guide.is_sure and self._guide.n_asked > 0

    @property
    def _ftol(self) -> float:
        """Relative gain that is too small: who names an error wants it, and every gain on the way."""
        return self._settings.ftol if self._settings.target_mse is None else 0.0

    @property
    def _least_gain(self) -> float:
        """Relative gain that is worth a round: who wants every gain knows when there is none left."""
        return max(self._ftol, DULL) if self._is_sure else self._ftol

    def _look_as_far_as_understood(self) -> None:
        """Shorten the horizon, once, of a search that is lost; lengthen it where what it sees is clear."""
        if self._is_guided:
            # What equations expect is of the whole.
            while not self._horizon.is_whole:
                self._look_further()
            return
        n_judged = self._n_known + self._n_design + self._settings.design_size(self._p)
        if not self._is_judged and self._objective.size >= n_judged and not self._is_falling:
            self._is_judged = True
            self._was_lost = self._unexplained > LOST
            if self._was_lost:
                self._horizon.shorten()
                self._begin_again()
        while not self._horizon.is_whole and self._unexplained <= UNDERSTOOD:
            self._look_further()

    @property
    def _is_falling(self) -> bool:
        """Whether the last rounds have brought much."""
        n_last = min(FALLING_ROUNDS * self._settings.n_parallel, self._settings.design_size(self._p))
        return bool(self._objective.min() < FALLING * self._objective[:-n_last].min())

    def _look_further(self) -> None:
        """Lengthen the horizon and go on from the row that is best then."""
        self._horizon.lengthen()
        self._begin_again()

    def _begin_again(self) -> None:
        """Judge all rows by the present horizon and begin a leg at the best."""
        self._judge()
        self._first = 0
        self._confirmation.begin_again()
        self._leg, self._idle, self._dull = [], 0, 0
        self._radius = self._settings.radius

    def _judge(self) -> None:
        error = np.mean(self._horizon.seen(self._residuals) ** 2, axis=1)
        self._objective = np.where(np.isfinite(self._penalty), error + self._penalty, np.inf)

    @property
    def _unexplained(self) -> float:
        """Share of a measured variance that the best row leaves unexplained. [1]."""
        return self._horizon.unexplained(self._residuals[int(np.argmin(self._objective))])

    def _step(self) -> None:
        """Make one round of a leg."""
        process = self._fit()
        if self._first == self._objective.size:
            self._weigh_failures(float(self._objective.min()))
            self._ask(self._elsewhere(process))
            self._leg.append(self._leg_best)
            return
        # A leg whose rows have all failed goes on from the best row.
        first = self._first if np.isfinite(self._leg_best) else 0
        best = first + int(np.argmin(self._objective[first:]))
        centre, centre_objective = self._u[best], float(self._objective[best])
        self._weigh_failures(centre_objective)
        points, expected = self._propose(process, centre)
        promise = centre_objective - expected.value
        if self._is_sure and promise <= self._least_gain * centre_objective:
            # The best point is known, and more rows would teach nothing: it is only looked for again.
            self.expected_gain = max(promise / centre_objective, 0.0) if centre_objective > 0.0 else 0.0
            self._idle += 1
            self._forget_proposal()
            return
        is_settled = self._confirmation.n_tested and self._has_whole_region and not self._is_guided
        if is_settled and self._is_home and promise <= self._ftol * centre_objective:
            # Nothing that was asked since the first test has changed what is expected here.
            self.expected_gain = promise / centre_objective if centre_objective > 0.0 else 0.0
            self._idle, self._dull = self._idle + 1, self._dull + 1
            return
        predicted = self._guide.predicted if self._guide is not None else None
        if self._is_far and not self._is_home:
            home = int(np.argmin(self._objective))
            is_end = np.abs(points[0] - centre).max() < AT_THE_EDGE * self._radius
            is_end |= np.abs(points[0] - self._u[home]).max() < AT_HOME
            if is_end and is_surely_no_better(process, points[0], expected, float(self._objective[home])):
                self._turn()
                return
        asked = self._objective.size
        self._ask(points)
        # The end of the budget may have cut off all points but the first ones.
        found = self._objective[asked:]
        gain = max(centre_objective - self._leg_best, 0.0)
        self._resize(points[0] - centre, found, gain, promise)
        self.expected_gain = promise / centre_objective if centre_objective > 0.0 else 0.0
        dull = max(self._ftol, DULL if self._horizon.is_whole else DULL_IN_A_BEGINNING)
        hope = max(gain, promise)
        if predicted is None:
            predicted = self._expand(process, points[0], self._settings.caution).value
        if is_surprised(float(found[0]), predicted, expected.value, centre_objective):
            hope = np.inf
        self._idle = self._idle + 1 if hope <= self._ftol * centre_objective else 0
        self._dull = self._dull + 1 if hope <= dull * centre_objective else 0
        self._leg.append(self._leg_best)

    @property
    def _leg_best(self) -> float:
        """The leg's lowest objective so far."""
        return float(self._objective[self._first :].min(initial=np.inf))

    @property
    def _is_home(self) -> bool:
        """Whether the leg is around the best row of all."""
        return self._leg_best <= float(self._objective.min())

    @property
    def _is_too_large(self) -> bool:
        """Whether the best error is too large for the bottom of the right valley."""
        doubtful = self._settings.doubtful_mse
        return doubtful is not None and self._recorder.best_mse > doubtful

    @property
    def _is_doubtful(self) -> bool:
        """Whether the best error is too large, and there may be a deeper valley that is worth looking for."""
        is_over = self._confirmation.is_excluded or self._is_tried or self._is_guided
        return self._is_too_large and not is_over

    @property
    def _is_tried(self) -> bool:
        """Whether enough was tried to explain an error that is too large."""
        return self._confirmation.n_restarts >= N_RESTARTS_DOUBTED

    @property
    def _may_end(self) -> bool:
        """Whether the search has looked elsewhere and believes what it has found."""
        has_looked = self._is_guided or self._confirmation.has_looked
        # Who names a target wants it, however little is expected.
        is_wanted = self._settings.target_mse is not None and not self._is_guided
        return has_looked and not self._is_doubtful and not is_wanted

    @property
    def _ending(self) -> Ending:
        """Why a search ends that expects nothing more."""
        target = self._settings.target_mse
        if self._is_guided:
            little = f"a gain of less than {self._least_gain:g} of the error"
            missed = "" if target is None else f"; the target of {target:g} is missed"
            nowhere = f", and nowhere {WANTED:g} times the error" if self._is_too_large else ""
            is_known = target is None or self._is_sure
            beyond = f", but {self._guide_errs}" if self._guide_errs else ""
            reason = f"the state equations expect {little}{nowhere}{missed}{beyond}"
            return Ending(reason, converged=is_known and not beyond)
        if self._is_too_large and not self._confirmation.is_excluded:
            return too_large(self._confirmation)
        if self._is_too_large:
            return Ending(
                f"{self._confirmation.in_words} gained no more, and the surrogate expects nowhere {WANTED:g} "
                "times the error",
                converged=not self._confirmation.is_promising,
            )
        return self._confirmation.ending

    @property
    def _guide_errs(self) -> str:
        """Says that believed state equations err by more than what makes an answer right, "" else."""
        if self._guide is None or not self._guide.is_believed or self._guide.error_at_best <= PROMISED:
            return ""
        return f"differ from the best simulation by {self._guide.error_at_best:.2g} of its error"

    @property
    def left(self) -> str:
        """What may be left to gain where a search stopped, and what the next round would try."""
        if not np.isfinite(self._recorder.best_mse):
            return ""
        if self._guide_errs:
            return f"the state equations {self._guide_errs}; --no-state-equations searches without them"
        if len(self._unasked) or self._objective.size < self._n_known + self._n_design:
            return "the first design is not finished, and the next round would go on with it"
        if self._is_too_large and self._is_tried:
            return "a deeper valley may be left, or the model lacks something; another seed begins anew"
        if not self._horizon.is_whole:
            return (
                "so far only the beginning of the trajectories is fitted; the next round would go on with it"
            )
        if self._is_home and not self._has_whole_region:
            return "simulations around the best point fail; the next round would begin away from it"
        if self._confirmation.n_tested or self._has_settled:
            return self._confirmation.still_owed(self._settings.ftol)
        n = min(self._settings.stall_rounds * self._settings.n_parallel, self._objective.size - 1)
        before = float(self._objective[: self._objective.size - n].min())
        gained = 1.0 - float(self._objective.min()) / before if np.isfinite(before) and before > 0.0 else 1.0
        return still_falling(n, gained, self.expected_gain)

    @property
    def is_flat(self) -> BoolArray:
        """On which parameters the error hardly depends around the best row, over all of their ranges."""
        if self._guide is not None and self._guide.is_sure:
            return self._guide.left_out
        process = self._last_process
        if process is None:
            return np.zeros(self._p, dtype=np.bool_)
        best = int(np.argmin(self._objective))
        across = np.tile(self._u[best], (self._p, N_ACROSS, 1))
        across[np.arange(self._p), :, np.arange(self._p)] = np.linspace(0.0, 1.0, N_ACROSS)
        errors = process.errors(across.reshape(-1, self._p)).reshape(self._p, N_ACROSS)
        return np.asarray(np.ptp(errors, axis=1) <= FLAT * self._objective[best])

    @property
    def slopes(self) -> FloatArray | None:
        """Slopes of the residuals at the best row, in an orthonormal basis of p residuals.

        A slope that rows leave open counts as large as it may be: what has none has been seen to have none.

        Returns:
            Shape (p, p), None where too little is known of the model. [first output's unit per range]
        """
        best = self._u[int(np.argmin(self._objective))]
        if self._guide is not None and self._guide.is_believed:
            return np.asarray(np.linalg.qr(self._guide.slopes(best), mode="r"))
        process = self._last_process
        if process is None:
            return None
        squares, axes = np.linalg.eigh(0.5 * self._residuals.shape[1] * process.expand(best, 1.0).hessian)
        return np.asarray(np.sqrt(np.maximum(squares, 0.0))[:, None] * axes.T)

    @cached_property
    def _last_process(self) -> ProcessGroups | None:
        """The surrogate of all rows, once there are no more; None where they are a first design or less."""
        is_enough = self._horizon.is_whole and self._objective.size > self._n_known + self._n_design
        if not is_enough or not 0.0 < self._objective.min() < np.inf or self._is_sane.sum() < 2:
            return None
        return self._fit()

    def _leg_is_over(self) -> bool:
        """Whether the leg has converged or, where there is somewhere else to go, gains too little."""
        settings = self._settings
        if self._is_guided:
            return self._idle >= min(settings.patience, DULL_ROUNDS)
        is_away = self._horizon.is_whole and not self._is_home
        if self._dull >= (settings.patience if is_away else DULL_ROUNDS):
            return True
        rounds, owed = settings.stall_rounds, settings.stall_gain
        if not self._is_home:
            rounds, owed = (rounds + 1) // 2, OWED_ELSEWHERE
        if settings.n_elsewhere == 0 or len(self._leg) <= rounds:
            return False
        return self._leg[-1] > (1.0 - owed) * self._leg[-1 - rounds]

    def _forget_proposal(self) -> None:
        """Tell the guide that its last point is not asked."""
        if self._guide is not None:
            self._guide.predicted = None

    def _turn(self) -> None:
        """End a leg: from the best row go elsewhere, from elsewhere back to it."""
        self._forget_proposal()
        is_wanted = self._settings.target_mse is not None
        leaves = self._is_home and (self._settings.n_elsewhere > 0 or self._is_doubtful or is_wanted)
        self._confirmation.n_restarts += leaves
        # A valley that still falls is followed to another place; from its bottom the search goes far.
        self._is_far = leaves and self._dull >= DULL_ROUNDS
        self._first = self._objective.size if leaves else 0
        self._radius = self._settings.radius if leaves else max(self._radius, self._settings.least_radius)
        self._leg, self._idle, self._dull = [], 0, 0

    def _ask(self, u: FloatArray) -> None:
        """Simulate rows, as many as the budget still holds, and keep what they answer."""
        left = self._settings.max_calls - self._recorder.n_calls
        u = np.round(u, DECIMALS)
        answer = self._recorder.evaluate(u[: max(left, 1)])
        self.n_rounds += math.ceil(answer.n / self._settings.n_parallel)
        self._keep(answer)
        if self._horizon.is_whole:
            self._confirmation.note_best(float(self._objective.min()))

    def _keep(self, answer: Evaluation) -> None:
        """Take rows among those that the search learns from."""
        self._u = np.concatenate([self._u, answer.u])
        earlier = self._residuals.reshape(self._penalty.size, answer.residuals.shape[1])
        self._residuals = np.concatenate([earlier, answer.residuals])
        penalty = np.full(answer.n, np.inf)
        good = np.isfinite(answer.mse)
        penalty[good] = answer.objective[good] - answer.mse[good]
        self._penalty = np.concatenate([self._penalty, penalty])
        self._judge()
        if self._guide is not None:
            self._guide.note(answer)

    def _fit(self) -> ProcessGroups:
        good = self._is_sane
        process = ProcessGroups.fit(
            self._features,
            self._u[good],
            self._horizon.seen(self._residuals[good]),
            self._hyper,
            # Who is lost has to understand what is large first.
            balance=not self._was_lost,
            # Beside hundreds of rows from all over the box, errors near the best row would pass for noise.
            n_doubted=int(good[: self._n_known].sum()) if self._n_known else None,
        )
        self._hyper = process.hyper
        return process

    def _weigh_failures(self, objective: float) -> None:
        """Learn where rows fail, and let that weigh as much as an objective. [unit squared]."""
        failed = ~np.isfinite(self._objective)
        if not failed.any():
            return
        known = Failures.fit(
            self._features, self._u, failed, self._prior, self._failed_hyper, scale=objective
        )
        self._failed_hyper, self._penalty_expected = known.process.hyper, known

    @property
    def _is_sane(self) -> BoolArray:
        """Which rows a surrogate learns from: beside diverged simulations all others would be alike."""
        finite = np.isfinite(self._objective)
        design = self._objective[: self._n_known + self._n_design]
        design = design[np.isfinite(design)]
        sane = finite & (self._objective <= ABSURD * np.quantile(design, 0.25)) if design.size else finite
        return sane if sane.sum() >= 2 else finite

    def _expand(self, process: ProcessGroups, u: FloatArray, caution: float) -> Expansion:
        return expected_objective(process, self._penalty_expected, u, caution)

    def _elsewhere(self, process: ProcessGroups) -> FloatArray:
        """Return where a leg elsewhere begins, one point for each parallel row."""
        expand, shape = partial(self._expand, process), (self._settings.n_parallel, self._p)
        if self._is_far:
            best, margin = float(self._objective.min()), self._settings.margin
            points, excess = least_excluded(expand, best, shape, margin, self._rng)
            known = self._confirmation
            known.n_excluded = known.n_excluded + 1 if excess > EXCLUDED else 0
            return points
        return farther_along(expand, self._settings.caution, shape, self._settings.margin, self._rng)

    def _propose(self, process: ProcessGroups, centre: FloatArray) -> tuple[FloatArray, Expansion]:
        """Return the points to simulate next, the favourite first, and what is expected of it."""
        # From a far valley a random start would find the way back.
        is_abroad = self._is_far and not self._is_home
        surroundings = Surroundings(
            process,
            self._penalty_expected,
            centre,
            self._radius,
            self._u,
            1 if is_abroad else self._settings.n_descents,
        )
        n_parallel, caution = self._settings.n_parallel, self._settings.caution
        if self._guide is not None and self._guide.is_believed:
            point, favourite = self._guide.propose(self._objective, self._u, self._rng)
            points = point[None]
        else:
            points, favourite = liked(surroundings, (n_parallel + 1) // 2, caution, self._rng)
        if len(points) < n_parallel:
            n_more = n_parallel - len(points)
            points = np.concatenate([points, telling(surroundings, points, favourite, n_more, self._rng)])
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
            self._radius = max(self._radius * SHRINK_AFTER_FAILURE, LEAST_RADIUS)
        elif gain < BAD_STEP * expected:
            self._radius = max(self._radius * SHRINK, min(self._radius, self._settings.least_radius))
        elif gain > GOOD_STEP * expected and np.abs(step).max() > AT_THE_EDGE * self._radius:
            self._radius = min(self._radius * GROW, 1.0)
