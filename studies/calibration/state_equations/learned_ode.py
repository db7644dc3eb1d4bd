"""State equations learnt during a calibration: they are fitted to its rows and propose the next point.

Solving the equations costs no call, so the whole box is searched: descents start from the best of many random
points, and the lowest end is simulated. The equations are believed while the solved rows agree with the
simulated ones; else the search goes on without them, until they agree again. They are sure where rows agree
so closely that more of them would add nothing.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.errors import InputError
from studies.calibration.box_newton import SAME_POINT, Expansion
from studies.calibration.descent import descend_together, jacobians, objectives
from studies.calibration.growing_rows import GrowingRows
from studies.calibration.largest_samples import outlying_part
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN, Coefficient, Points
from studies.calibration.state_equations.equation_model import EquationExperiments, EquationModel
from studies.calibration.state_equations.equations import NO_FORMULAS, StateEquations, Structure
from studies.calibration.state_equations.hidden_inputs import Course, LocalVariables
from studies.calibration.state_equations.product_forms import Products
from studies.calibration.state_equations.states import StateRows, StateSignals, WatchedModel
from studies.calibration.state_equations.switch_positions import (
    SwitchPositions,
    with_positions,
    with_switches,
)
from studies.calibration.state_equations.term_choice import Fit
from studies.calibration.state_equations.terms import spread

# Random points that are looked at, and how many of the best of them, beside the best rows and the last ends,
# are walked downhill: nothing else looks for valleys.
N_LOOKS, N_RANDOM, N_ROWS, N_ENDS = 400, 20, 2, 2
# So many points that fail end the belief.
MOST_FAILED = 4
# Squares of the differences between solved and simulated residuals, as shares of a row's error, up to which
# exact equations match it, and up to which they are believed: beyond, the model does something else, as where
# a state jumps. So many of the last rows are looked at; an error counts the first of their median more.
# 3 % and 14 % of the residuals, squared. A jump of 0.1 to 0.3 K left all formulas valid, and a search
# that checked these alone ended at 2 to 13 times the error (docs/notes/state-equations.md, Whole powers).
MATCHED, BELIEVED, N_MATCHED = 1e-3, 2e-2, 16
# A course of hidden inputs is taken for another one that misses this part of it or less.
# Without it, smooth signals were made to jump to mend others' jumps (the same note, Weather inside the FMU).
CLEARLY = 0.8
# Range of a state that hardly moves, as a share of its size.
AT_REST = 1e-6
# Parts of the time that walks of equations with switches fit first, one after the other.
# Of 16 such searches all ended at the least error (docs/notes/state-equations.md, Switches).
PARTS = (1 / 16, 1 / 8, 1 / 4, 1 / 2)

# Rows after which equations are taken though some coefficient is no formula, by parameter and at least.
# With 14 rows at first, 14 parameters took 16 calls to 1.02 times instead of 12;
# with 8 rows, up to 31 (the same note, First form).
PER_PARAMETER, LEAST_ROWS = 2.0 / 3.0, 6

DIFFERENT = "not all simulations follow the same ones"
NOT_FINITE = "numbers overflow where they are fitted"

LEAST_CALLS = LEAST_TO_LEARN + 1
"""The rows that the simplest equations are learnt from, and the best point that these expect."""

Seen = Callable[[FloatArray], StateRows]
"""Parameters (n, p) of rows that were answered last to what states did there, NaN where that is not known."""


def enough_for_equations(n_parameters: int) -> int:
    """Return how many rows of a first design state equations take at most."""
    return max(math.ceil(PER_PARAMETER * n_parameters), LEAST_ROWS)


class LearnedODE:
    """The state equations of a calibration problem, as far as its rows show them."""

    def __init__(self, signals: StateSignals, seen: Seen, problem: CalibrationProblem) -> None:
        """Begin with nothing known.

        Args:
            signals: What is known of the states.
            seen: Returns what they did.
            problem: The problem.
        """
        self._signals = signals
        self._locals = LocalVariables(signals)
        self._positions = SwitchPositions(signals)
        self._course: Course | None = None
        self._seen = seen
        self._problem = problem
        self._sensor = float(problem.measurement.uncertainty[0])
        self._products = Products.of(problem.space)
        self._u = np.empty((0, problem.space.n_parameters))
        self._rows: list[StateRows] = []
        self._answers = GrowingRows(problem.measurement.n_samples)
        self._structure: Structure | None = None
        self._fits = list[tuple[Fit, ...]]()
        self._doubted: int | None = None
        self._n_examined = 0
        self._lacked = ""
        self._is_refuted = False
        self._equations: StateEquations | None = None
        self._is_given = self.is_given_up = False
        self.predicted: float | None = None
        self._ends = self._u
        self._n_failed = 0
        self._has_failed = False
        self._mismatch = 0.0
        self.misfit = np.inf
        self.n_asked = self.n_alone = 0
        self._think_of: Callable[[str], None] = lambda what: None
        self.why_not = f"fewer than {LEAST_TO_LEARN} simulations show what states did"

    @classmethod
    def of(cls, problem: CalibrationProblem) -> Self:
        """Return what learns the equations of a problem that is posed to a model that watches its states.

        Raises:
            InputError: It is posed to another model.
        """
        model = problem.model
        if not isinstance(model, WatchedModel):
            raise InputError(
                f"state equations need a WatchedModel, not {type(model).__name__}; see calibration.states"
            )
        return cls(model.signals, model.seen, problem)

    @property
    def is_believed(self) -> bool:
        """Whether it has equations that do what the rows do, and have not led to failures."""
        is_known = self._equations is not None and self._mismatch <= BELIEVED
        return is_known and self._n_failed < MOST_FAILED

    @property
    def is_sure(self) -> bool:
        """Whether the equations match what was simulated: more rows would add nothing."""
        return self._mismatch <= MATCHED and not self._has_failed and self.is_believed

    @property
    def model(self) -> EquationModel | EquationExperiments | None:
        """A model that answers by the equations, None where they are not known exactly."""
        if self._equations is None or not self.is_sure:
            return None
        return EquationModel(self._equations, self._problem.space, self._problem.model.time)

    @property
    def is_learnt(self) -> bool:
        """Whether it has equations, believed or not."""
        return self._equations is not None

    @property
    def hidden_inputs(self) -> tuple[str, ...]:
        """Names of the variables of the FMU that the equations take as inputs beside the declared ones."""
        return self._signals.inputs[self._signals.n_declared :] if self.is_learnt else ()

    @property
    def error_at_best(self) -> float:
        """How solved equations differ from the best simulation, as a share of its squared residuals. [1]."""
        mse = np.mean(self._answered**2, axis=1)
        best = int(np.argmin(mse))
        error = self._errors(self._u[[best]], self._answered[[best]])[0]
        rest = mse[best] - outlying_part(self._answered[best], self._sensor)
        share = float(error / (rest + np.finfo(float).tiny))
        return share if np.isfinite(share) else np.inf

    @property
    def without_effect(self) -> tuple[str, ...]:
        """Names of the parameters that are in none of the equations that it believes."""
        names = self._problem.space.names
        is_out = self.left_out if self.is_sure else np.zeros(len(names), dtype=np.bool_)
        return tuple(name for name, out in zip(names, is_out, strict=True) if out)

    @property
    def left_out(self) -> BoolArray:
        """Which parameters are in no equation: what they do, as where a weir begins, no row has shown."""
        p = self._problem.space.n_parameters
        if self._equations is None:
            return np.zeros(p, dtype=np.bool_)
        moved = np.concatenate([np.full((1, p), 0.5), 0.5 + 0.17 * np.eye(p)])
        with np.errstate(all="ignore"):
            values = self._equations.coefficients(Points.of(self._problem.space, moved))
        # Equal bit for bit: a formula without the parameter repeats the same operations.
        return np.asarray((values[1:] == values[0]).all(axis=1))

    def unseen(self, u: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
        """Return points where equations may act that no row has shown.

        These are a point with all that is left out at either end of its range, and points where states go
        farthest beyond what any row has shown, by the equations.

        Args:
            u: The point. Shape (p,). [1]
            n: How many are returned.
            rng: Source of the points that are compared.

        Returns:
            Shape (n, p). [1]
        """
        assert self._equations is not None, "equations are learnt before they are solved"
        left_out = self.left_out
        ends = [np.where(left_out, end, u) for end in (0.0, 1.0)] if left_out.any() else []
        looks = rng.random((max(N_LOOKS, n), len(u)))
        with np.errstate(all="ignore"):
            least, greatest = self._equations.reach(Points.of(self._problem.space, looks))
        seen = self._all_rows(self._signals).x
        low, high = seen.min(axis=(0, 1)), seen.max(axis=(0, 1))
        # Of a state at rest rounding is no reach.
        span = np.maximum(high - low, AT_REST * np.abs(seen).max(axis=(0, 1)) + np.finfo(float).tiny)
        beyond = np.concatenate([low - least, greatest - high], axis=1) / np.tile(span, 2)
        beyond = np.where(np.isfinite(beyond), np.maximum(beyond, 0.0), 0.0)
        # By turns the farthest of every state in either direction, those first that go farthest.
        columns = np.argsort(-beyond.max(axis=0), kind="stable")
        order = np.argsort(-beyond[:, columns[beyond.max(axis=0)[columns] > 0.0]], axis=0, kind="stable")
        farthest = list(dict.fromkeys([*order.reshape(-1).tolist(), *range(len(looks))]))
        # An end that was simulated already adds nothing.
        fresh = [end[None] for end in ends if np.abs(self._u - end).max(axis=1).min() > SAME_POINT]
        return np.concatenate([*fresh, looks[farthest]])[:n]

    def slopes(self, u: FloatArray) -> FloatArray:
        """Return the residuals' slopes at a point by the equations. Shape (m, p). [unit per range].

        Args:
            u: The point. Shape (p,). [1]
        """
        return np.asarray(jacobians(self._residuals, u[None], self._residuals(u[None]))[0])

    @property
    def _answered(self) -> FloatArray:
        """Residuals of the rows that it has learnt from. Shape (n, m). [first output's unit]."""
        return self._answers.rows

    @property
    def n_states(self) -> int:
        """States whose equations it learns, without positions of switches."""
        return self._signals.n_continuous

    def learn_alone(self, u: FloatArray) -> int:
        """Learn from rows that cost less than a whole one, as those of single experiments do.

        Args:
            u: Points of the first design. Shape (n, p). [1]

        Returns:
            How many whole rows they are worth, rounded up: none here.
        """
        return 0

    def follow(self, equations: StateEquations, misfit: float) -> None:
        """Take equations that another experiment has shown, until a row of this one differs.

        Args:
            equations: The equations.
            misfit: What they leave there. [1]
        """
        self._equations, self._is_given, self.misfit = equations, True, misfit

    def with_effect(
        self, equations: StateEquations, answer: Evaluation, amount: float
    ) -> StateEquations | None:
        """Return another experiment's equations with what the change of a fixed value adds to them here.

        Args:
            equations: The equations.
            answer: One row of this experiment.
            amount: The change. [FMU's unit]

        Returns:
            The equations; None where the row failed or shows something else.
        """
        rows = self._seen(answer.theta)
        if not all(np.isfinite(part).all() for part in rows[:3]):
            return None
        return equations.with_effect(Points.of(self._problem.space, answer.u), rows, amount, self._products)

    def knows(self, u: FloatArray) -> BoolArray:
        """Return which points (n, p) it has learnt from. Shape (n,)."""
        return np.asarray((self._u == u[:, None]).all(axis=2).any(axis=1))

    def report_to(self, think_of: Callable[[str], None]) -> None:
        """Call this from now on with what is looked at, as that may take seconds."""
        self._think_of = think_of

    def note(self, answer: Evaluation) -> None:
        """Learn from rows that were asked.

        Args:
            answer: The rows; failed ones teach nothing.
        """
        if self._is_refuted:
            return
        was_confirmed = self.is_sure and self.n_asked > 0 and not self._is_given
        good = np.isfinite(answer.mse)
        # Equations know nothing of failures, and would lead there again and again.
        self._has_failed = self.predicted is not None and not good[0]
        self._n_failed += self._has_failed
        self.n_asked += self.predicted is not None
        self.predicted = None
        rows = self._seen(answer.theta)
        whole = good & np.all([np.isfinite(part).all(axis=(1, 2)) for part in rows[:3]], axis=0)
        if not whole.any():
            return
        is_missed = was_confirmed and self._mismatch_of(answer.u[whole], answer.residuals[whole]) > MATCHED
        self._u = np.concatenate([self._u, answer.u[whole]])
        self._rows.append(StateRows(*(part[whole] for part in rows[:3])))
        shown = None if rows.locals is None else rows.locals[whole]
        self._locals.note(shown)
        self._positions.note(shown)
        self._answers.add(answer.residuals[whole])
        if self._is_given:
            self._mismatch = self._mismatch_of(self._u, self._answered)
            # Written so that NaN counts as a mismatch, too.
            self._is_given = self._mismatch <= MATCHED
            if self._is_given:
                return
        try:
            learnt = self._learnt()
        # As of a matrix that is not finite: what cannot be fitted is not learnt.
        except np.linalg.LinAlgError:
            learnt = NOT_FINITE
        if is_missed and isinstance(learnt, str):
            # Formulas that held and hold no more: this row belongs to another regime.
            learnt, self._is_refuted = DIFFERENT, True
        if isinstance(learnt, str):
            self.why_not = learnt
        self._equations = None if isinstance(learnt, str) else learnt
        self._mismatch = self._mismatch_of(self._u[-N_MATCHED:], self._answered[-N_MATCHED:])

    @np.errstate(all="ignore")
    def _learnt(self) -> StateEquations | str:
        """Learn the equations from all rows; say in words why there are none."""
        if self._structure is None:
            # What follows no such equations is looked at again when twice as much is known.
            if len(self._u) < max(2 * self._n_examined, LEAST_TO_LEARN):
                return self.why_not
            self._n_examined = len(self._u)
            signals, structure = self._found_structure()
            self.misfit = structure.misfit
            self._lacked = structure.lacking
            if structure.lacking:
                return structure.why_not(signals)
            self._signals, self._structure = structure.of_used(signals)
            self._course, self._fits, self._doubted = None, [], None
        rows = self._all_rows(self._signals)
        # A row's fit does not change with others.
        new = StateRows(*(part[len(self._fits) :] for part in rows[:3]))
        self._fits += self._structure.fits(self._signals, new)
        found, self.misfit = self._structure.coefficients(self._fits)
        # Written so that NaN counts as a misfit, too.
        if not self.misfit <= self._structure.most_left:
            self._structure = None
            return DIFFERENT
        points = Points.of(self._problem.space, self._u)
        columns = [column for table in (*found, rows.x[:, 0]) for column in table.T]
        # What was no formula with a row less is looked at first, as it mostly is none again.
        if self._doubted is not None and self._is_open(points, columns[self._doubted]):
            return NO_FORMULAS
        # One more row may show what a coefficient is, or a switch does: the structure stays.
        equations = StateEquations.learn(
            self._signals, self._structure, points, rows.x, found, self._products
        )
        is_open = (place for place, column in enumerate(columns) if self._is_open(points, column))
        self._doubted = next(is_open) if equations == NO_FORMULAS else None
        if self._signals.n_hidden and self._course is None and isinstance(equations, StateEquations):
            return self._with_course(equations, points, rows.x)
        return equations

    def _is_open(self, points: Points, column: FloatArray) -> bool:
        """Return whether a coefficient, of values (n,) at points, is no formula."""
        return Coefficient.fit(points, column, self._products) is None

    def _found_structure(self) -> tuple[StateSignals, Structure]:
        """Find the terms, with positions of switches where there are none without."""
        signals = self._locals.as_inputs()

        def think_of(name: str) -> None:
            self._think_of(f"terms of {name}")

        structure = Structure.of(signals, self._all_rows(signals), self._lacked, think_of)
        switches = tuple(self._positions.known())
        while structure.lacking and switches:
            switching = with_switches(signals, switches)
            found = Structure.of(switching, self._all_rows(switching), structure.lacking, think_of)
            if found.lacking:
                break
            # What no term has needs no rule.
            used = found.used()
            n = len(signals.states)
            needed = tuple(name for place, name in enumerate(switches, n) if place in used)
            if needed == switches:
                return switching, found
            switches = needed
        return signals, structure

    def _all_rows(self, signals: StateSignals) -> StateRows:
        """Return what states and outputs did in all rows, switches among the states."""
        rows = StateRows(
            *(np.concatenate(part) for part in zip(*(one[:3] for one in self._rows), strict=True))
        )
        known = self._positions.known()
        return with_positions(rows, [known[name] for name in signals.states[signals.n_continuous :]])

    def _with_course(self, equations: StateEquations, points: Points, x: FloatArray) -> StateEquations:
        """Find what hidden inputs do between the outputs; return equations that follow it."""
        self._think_of("what inputs inside the FMU do between the outputs")
        signals = self._signals
        n_declared = signals.n_declared
        some = spread(len(x), LEAST_TO_LEARN)
        points, x = points.part(some), x[some]
        # A jump placed 20 minutes wrong, of 30, left 8 % of the residuals' squares, and
        # equations were not believed (docs/notes/state-equations.md, Weather inside the FMU).
        course = Course(signals.at_outputs[:, n_declared:], signals.every)
        least, before = equations.missed(points, x), np.inf
        while least < CLEARLY * before:
            before = least
            # Signal by signal until nothing changes: combinations of all their places would be too many.
            for one in range(signals.n_hidden):
                for other in course.others(one):
                    driven = np.concatenate([signals.driven[:, :n_declared], other.driven], axis=1)
                    changed = equations.with_signals(replace(signals, driven=driven))
                    missed = changed.missed(points, x)
                    if missed < CLEARLY * least:
                        equations, course, least = changed, other, missed
        self._course, self._signals = course, equations.signals
        return equations

    def _mismatch_of(self, u: FloatArray, answered: FloatArray) -> float:
        """Return how equations, solved, differ from what was simulated, as a share of errors. [1]."""
        if self._equations is None:
            return 0.0
        mse = np.mean(answered**2, axis=1) - [outlying_part(row, self._sensor) for row in answered]
        shares = self._errors(u, answered) / (mse + MATCHED * np.median(mse))
        return float(np.max(np.where(np.isfinite(shares), shares, np.inf)))

    def propose(
        self, objective: FloatArray, known: FloatArray, rng: np.random.Generator
    ) -> tuple[FloatArray, Expansion]:
        """Return the point to ask next, and what is expected of it.

        Args:
            objective: Of the rows so far, infinite where they failed. Shape (n,). [unit squared]
            known: Their points. Shape (n, p). [1]
            rng: Source of the looks.
        """
        self._think_of("optimum by the state equations")
        p = known.shape[1]
        prior = self._problem.prior
        looks = self._looks(p, rng)
        best = np.argsort(objectives(prior, looks, self._residuals(looks)), kind="stable")
        best = best[:N_RANDOM]
        rows = np.argsort(objective, kind="stable")[:N_ROWS]
        starts = np.concatenate([known[rows], self._ends, looks[best]])
        ends, values = descend_together(self._residuals, prior, starts)
        order = np.argsort(values, kind="stable")
        # One more row moves the optimum little: the next descents begin where these have ended.
        self._ends = ends[order[:N_ENDS]]
        u, value = ends[order[0]], float(values[order[0]])
        distance = np.abs(known - u).max(axis=1)
        if distance.min(initial=np.inf) < SAME_POINT:
            nearest = int(np.argmin(distance))
            # That point is known; one a little beside adds more.
            if self.is_sure and np.isfinite(objective[nearest]):
                value = float(objective[nearest])
            u = np.clip(u + rng.uniform(-0.02, 0.02, p), 0.0, 1.0)
        self.predicted = float(objectives(prior, u[None], self._residuals(u[None]))[0])
        # With no curvature, points that are drawn beside this one spread alike in all directions.
        return u, Expansion.known(value, value, np.zeros(p), np.zeros((p, p)))

    def _looks(self, p: int, rng: np.random.Generator) -> FloatArray:
        """Return points of which the best are walked downhill. Shape (n, p). [1]."""
        looks = rng.random((N_LOOKS, p))
        if not self._signals.n_switches:
            return looks
        # The error over the whole time jumps with the number of changes; over a short time there are few.
        ends, measurement = looks[:0], self._problem.measurement
        for part in PARTS:
            n = math.ceil(part * len(measurement.time))
            late = np.zeros((1, len(measurement.time), len(measurement.output_names)))
            late[:, n:] = 1.0
            is_seen = (measurement.compared(late) == measurement.compared(0.0 * late))[0]

            def residuals(u: FloatArray, n: int = n, is_seen: BoolArray = is_seen) -> FloatArray:
                return self._residuals(u, n)[:, is_seen]

            starts = np.concatenate([ends, rng.random((N_LOOKS, p))])
            best = np.argsort(objectives(None, starts, residuals(starts)), kind="stable")[:N_RANDOM]
            ends, _ = descend_together(residuals, self._problem.prior, starts[best])
        return np.concatenate([ends, looks])

    @np.errstate(all="ignore")
    def _errors(self, u: FloatArray, answered: FloatArray) -> FloatArray:
        """Return the mean squared differences of the equations' residuals and simulated ones. Shape (n,)."""
        errors: FloatArray = np.mean((self._residuals(u) - answered) ** 2, axis=1)
        return errors

    @np.errstate(all="ignore")
    def _residuals(self, u: FloatArray, n_outputs: int | None = None) -> FloatArray:
        """Return the residuals (n, m), those after the first outputs as if the rest were zero."""
        measurement = self._problem.measurement
        if n_outputs is None:
            return measurement.compared(self.outputs(u))
        y = np.zeros((len(u), len(measurement.time), len(measurement.output_names)))
        y[:, :n_outputs] = self.outputs(u, n_outputs)
        return measurement.compared(y)

    def outputs(self, u: FloatArray, n_outputs: int | None = None) -> FloatArray:
        """Solve the equations.

        Args:
            u: Points. Shape (n, p). [1]
            n_outputs: How many of the first output times; None for all.

        Returns:
            Shape (n, t, k). [per output]
        """
        assert self._equations is not None, "equations are learnt before they are solved"
        equations = self._equations if n_outputs is None else self._equations.until(n_outputs)
        return equations.outputs(Points.of(self._problem.space, u))
