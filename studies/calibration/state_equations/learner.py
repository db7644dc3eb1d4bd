"""The state equations of one experiment, learnt from its rows as they come."""

from collections.abc import Callable

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.layout import Experiment
from studies.calibration.box_newton import SAME_POINT
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.state_equations.belief import MATCHED, Belief, mismatch
from studies.calibration.state_equations.coefficient import Points
from studies.calibration.state_equations.equations import StateEquations
from studies.calibration.state_equations.identification import DIFFERENT, Identification, LearntRows
from studies.calibration.state_equations.states import StateRows, StateSignals
from studies.calibration.state_equations.terms import TINY

# So many of the last rows are compared with solved ones: it costs a solution of each.
N_COMPARED = 16
# Points at which the equations' reach is looked at.
N_REACHED = 400
# Range of a state that hardly moves, as a share of its size: of a state at rest rounding is no reach.
LEAST_RANGE = 1e-6

Seen = Callable[[FloatArray], StateRows]
"""Parameters (n, p) of rows that were answered last to what states did there, NaN where that is not known."""


class EquationLearner:
    """The state equations of one experiment, as far as its rows show them.

    Attributes:
        problem: The experiment's own problem.
        seen: Returns what its states did.
        name: Its name, "" for a single one.
        parameters: Columns of its parameters among those of all experiments.
        outputs: Columns of its outputs.
        rows: What they are learnt from.
        known: What is known of them.
        equations: The equations, None where there are none.
    """

    def __init__(
        self,
        signals: StateSignals,
        seen: Seen,
        problem: CalibrationProblem,
        experiment: Experiment | None = None,
    ) -> None:
        """Begin with nothing known.

        Args:
            signals: What is known of the states.
            seen: Returns what they did.
            problem: The experiment's problem.
            experiment: Where it stands among several, None for a single one.
        """
        self.problem, self.seen = problem, seen
        self.name = "" if experiment is None else experiment.name
        self.parameters: IntArray | slice = slice(None) if experiment is None else experiment.parameters
        self.outputs: IntArray | slice = slice(None) if experiment is None else experiment.outputs
        self.rows = LearntRows(signals, problem.space.n_parameters, problem.measurement.n_samples)
        self.known = Identification(signals, problem.space)
        self.equations: StateEquations | None = None
        self._belief = Belief()
        self._is_given = self._is_refuted = self._has_proposed = False

    @property
    def is_believed(self) -> bool:
        """Whether it has equations that do what the rows do, and have not led to failures."""
        return self.equations is not None and self._belief.is_kept

    @property
    def is_sure(self) -> bool:
        """Whether the equations match what was simulated: more rows would add nothing."""
        return self.equations is not None and self._belief.is_sure

    @property
    def left_out(self) -> BoolArray:
        """Which parameters are in no equation. Shape (p,)."""
        p = self.problem.space.n_parameters
        if self.equations is None:
            return np.zeros(p, dtype=np.bool_)
        moved = np.concatenate([np.full((1, p), 0.5), 0.5 + 0.17 * np.eye(p)])
        with np.errstate(all="ignore"):
            values = self.equations.coefficients(Points.of(self.problem.space, moved))
        # Equal bit for bit: a formula without the parameter repeats the same operations.
        return np.asarray((values[1:] == values[0]).all(axis=1))

    def unseen(self, u: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
        """Return points where equations may act that no row has shown, see `LearnedODE.unseen`."""
        assert self.equations is not None, "equations are learnt before they are solved"
        left_out = self.left_out
        ends = [np.where(left_out, end, u) for end in (0.0, 1.0)] if left_out.any() else []
        looks = rng.random((max(N_REACHED, n), len(u)))
        with np.errstate(all="ignore"):
            least, greatest = self.equations.reach(Points.of(self.problem.space, looks))
        seen = self.rows.states(self.known.signals).x
        low, high = seen.min(axis=(0, 1)), seen.max(axis=(0, 1))
        span = np.maximum(high - low, LEAST_RANGE * np.abs(seen).max(axis=(0, 1)) + TINY)
        beyond = np.concatenate([low - least, greatest - high], axis=1) / np.tile(span, 2)
        beyond = np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0)
        # By turns the farthest of every state in either direction, those first that go farthest.
        columns = np.argsort(-beyond.max(axis=0), kind="stable")
        order = np.argsort(-beyond[:, columns[beyond.max(axis=0)[columns] > 0.0]], axis=0, kind="stable")
        farthest = list(dict.fromkeys([*order.reshape(-1).tolist(), *range(len(looks))]))
        # An end that was simulated already adds nothing.
        fresh = [end[None] for end in ends if np.abs(self.rows.u - end).max(axis=1).min() > SAME_POINT]
        return np.concatenate([*fresh, looks[farthest]])[:n]

    def follow(self, equations: StateEquations, misfit: float) -> None:
        """Take equations that another experiment has shown, until a row of this one differs.

        Args:
            equations: The equations.
            misfit: What they leave there. [1]
        """
        self.equations, self._is_given, self.known.misfit = equations, True, misfit

    def note(self, answer: Evaluation, *, is_proposed: bool) -> None:
        """Learn from rows that were asked.

        Args:
            answer: The rows; failed ones teach nothing.
            is_proposed: Whether the equations had proposed the first of them.
        """
        if self._is_refuted:
            return
        was_confirmed = self.is_sure and self._has_proposed and not self._is_given
        good = np.isfinite(answer.mse)
        # Equations know nothing of failures, and would lead there again and again.
        self._belief.has_failed = is_proposed and not bool(good[0])
        self._belief.n_failed += self._belief.has_failed
        self._has_proposed |= is_proposed
        rows = self.seen(answer.theta)
        whole = good & rows.are_known
        if not whole.any():
            return
        self.rows.add(answer.u[whole], rows.take(whole), answer.residuals[whole])
        is_missed = was_confirmed and self._mismatch(int(whole.sum())) > MATCHED
        if self._is_given:
            self._belief.mismatch = self._mismatch(len(self.rows.u))
            # Written so that NaN counts as a mismatch, too.
            self._is_given = self._belief.mismatch <= MATCHED
            if self._is_given:
                return
        self.equations = self.known.equations(self.rows)
        if is_missed and self.equations is None:
            # Formulas that held and hold no more: this row belongs to another regime.
            self.known.why_not, self._is_refuted = DIFFERENT, True
        self._belief.mismatch = self._mismatch(N_COMPARED)

    def note_part(self, answer: Evaluation, *, is_proposed: bool) -> None:
        """Learn from rows of all experiments, as far as this one is new in them, see `note`."""
        # What was simulated alone is no news in a whole row.
        rows = np.flatnonzero(~self.rows.hold(answer.u[:, self.parameters]))
        if not rows.size:
            return
        measurement = self.problem.measurement
        y = np.ascontiguousarray(answer.y[rows, : len(measurement.time)][..., self.outputs])
        residuals = measurement.compared(y)
        mse = np.where(np.isfinite(answer.mse[rows]), np.mean(residuals**2, axis=1), np.inf)
        u, theta = (np.ascontiguousarray(one[rows][:, self.parameters]) for one in (answer.u, answer.theta))
        failures = tuple(answer.failures[row] for row in rows)
        self.note(Evaluation(u, theta, y, residuals, mse, mse, failures), is_proposed=is_proposed)

    def _mismatch(self, n: int) -> float:
        """Return how equations, solved, differ from the last n rows at the most. [1]."""
        if self.equations is None:
            return 0.0
        measurement = self.problem.measurement
        with np.errstate(all="ignore"):
            solved = measurement.compared(self.solved(self.rows.u[-n:]))
        return mismatch(solved, self.rows.residuals[-n:], float(measurement.uncertainty[0]))

    def solved(self, u: FloatArray, n_outputs: int | None = None) -> FloatArray:
        """Solve the equations.

        Args:
            u: Points. Shape (n, p). [1]
            n_outputs: How many of the first output times; None for all.

        Returns:
            Shape (n, t, k). [per output]
        """
        assert self.equations is not None, "equations are learnt before they are solved"
        equations = self.equations if n_outputs is None else self.equations.until(n_outputs)
        return equations.outputs(Points.of(self.problem.space, u))
