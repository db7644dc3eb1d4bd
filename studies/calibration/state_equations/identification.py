"""Identification of one experiment's state equations from its rows: their terms, then their coefficients."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.parameters import ParameterSpace
from studies.calibration.growing_rows import GrowingRows
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN, Coefficient, Points
from studies.calibration.state_equations.equations import NO_FORMULAS, StateEquations, Structure
from studies.calibration.state_equations.hidden_inputs import Course, LocalVariables
from studies.calibration.state_equations.product_forms import Products
from studies.calibration.state_equations.states import StateRows, StateSignals
from studies.calibration.state_equations.switch_positions import (
    SwitchPositions,
    with_positions,
    with_switches,
)
from studies.calibration.state_equations.term_choice import Fit
from studies.calibration.state_equations.terms import spread

# A course of hidden inputs is taken for another one that misses this part of it or less.
# Without it, smooth signals were made to jump to mend others' jumps (docs/notes/state-equations.md,
# Weather inside the FMU).
BETTER_COURSE = 0.8

DIFFERENT = "not all simulations follow the same ones"
NOT_FINITE = "numbers overflow where they are fitted"


class LearntRows:
    """Rows whose states are known.

    Attributes:
        u: Their points. Shape (n, p). [1]
        hidden: The variables that follow time alone in all of them.
        switches: The variables of two values.
    """

    def __init__(self, signals: StateSignals, n_parameters: int, n_residuals: int) -> None:
        """Begin without rows.

        Args:
            signals: What is known of the states.
            n_parameters: Parameters p.
            n_residuals: Residuals m of a row.
        """
        self.u = np.empty((0, n_parameters))
        self.hidden, self.switches = LocalVariables(signals), SwitchPositions(signals)
        self._states, self._residuals = list[StateRows](), GrowingRows(n_residuals)

    @property
    def residuals(self) -> FloatArray:
        """Simulated residuals. Shape (n, m). [first output's unit]."""
        return self._residuals.rows

    def add(self, u: FloatArray, rows: StateRows, residuals: FloatArray) -> None:
        """Add rows: points (k, p), what states did there, and residuals (k, m)."""
        self.u = np.concatenate([self.u, u])
        self._residuals.add(residuals)
        self._states.append(rows._replace(locals=None))
        self.hidden.note(rows.locals)
        self.switches.note(rows.locals)

    def states(self, signals: StateSignals) -> StateRows:
        """Return what states and outputs did in all rows, the signals' switches among the states."""
        # The fourth part, other variables, is None.
        x, slope, y, _ = zip(*self._states, strict=True)
        rows = StateRows(np.concatenate(x), np.concatenate(slope), np.concatenate(y))
        positions = self.switches.known()
        return with_positions(rows, [positions[name] for name in signals.states[signals.n_continuous :]])

    def hold(self, u: FloatArray) -> BoolArray:
        """Return which points (n, p) are among them. Shape (n,)."""
        return np.asarray((self.u == u[:, None]).all(axis=2).any(axis=1))


class Identification:
    """What is known of the equations of one experiment.

    Attributes:
        signals: What is known of the states, with the hidden inputs and switches that equations have.
        products: Of the box's parameters.
        misfit: Greatest share of squares that a derivative's or an output's terms leave. [1]
        why_not: Why there are no equations, in words.
        think_of: Called with what is looked at, as that may take seconds.
    """

    def __init__(self, signals: StateSignals, space: ParameterSpace) -> None:
        """Begin with nothing known.

        Args:
            signals: What is known of the states.
            space: The parameters.
        """
        self.signals, self._space, self.products = signals, space, Products.of(space)
        self.misfit = np.inf
        self.why_not = f"fewer than {LEAST_TO_LEARN} simulations show what states did"
        self.think_of: Callable[[str], None] = lambda subject: None
        self._structure: Structure | None = None
        self._n_examined, self._lacked = 0, ""
        self._fits = list[tuple[Fit, ...]]()
        self._doubted: int | None = None
        self._has_course = False

    def equations(self, rows: LearntRows) -> StateEquations | None:
        """Return the equations that all rows follow, None where there are none: `why_not` says why."""
        try:
            learnt = self._learnt(rows)
        # As of a matrix that is not finite: what cannot be fitted is not learnt.
        except np.linalg.LinAlgError:
            learnt = NOT_FINITE
        if isinstance(learnt, str):
            self.why_not = learnt
            return None
        return learnt

    @np.errstate(all="ignore")
    def _learnt(self, rows: LearntRows) -> StateEquations | str:
        """Return the equations, or in words why there are none."""
        if self._structure is None:
            # What follows no such equations is looked at again when twice as much is known.
            if len(rows.u) < max(2 * self._n_examined, LEAST_TO_LEARN):
                return self.why_not
            self._n_examined = len(rows.u)
            signals, structure = self._terms(rows)
            self.misfit, self._lacked = structure.misfit, structure.lacking
            if structure.lacking:
                return structure.why_not(signals)
            self.signals, self._structure = structure.of_used(signals)
            self._has_course, self._fits, self._doubted = False, [], None
        states = rows.states(self.signals)
        # A row's fit does not change with others.
        self._fits += self._structure.fits(self.signals, states.take(slice(len(self._fits), None)))
        coefficients, self.misfit = self._structure.coefficients(self._fits)
        # Written so that NaN counts as a misfit, too.
        if not self.misfit <= self._structure.most_left:
            self._structure = None
            return DIFFERENT
        points = Points.of(self._space, rows.u)
        columns = [column for table in (*coefficients, states.x[:, 0]) for column in table.T]
        # What was no formula with a row less is looked at first, as it mostly is none again.
        if self._doubted is not None and self._is_open(points, columns[self._doubted]):
            return NO_FORMULAS
        # One more row may show what a coefficient is, or a switch does: the structure stays.
        equations = StateEquations.learn(
            self.signals, self._structure, points, states.x, coefficients, self.products
        )
        is_open = (place for place, column in enumerate(columns) if self._is_open(points, column))
        self._doubted = next(is_open) if equations == NO_FORMULAS else None
        if self.signals.n_hidden and not self._has_course and isinstance(equations, StateEquations):
            return self._with_course(equations, points, states.x)
        return equations

    def _is_open(self, points: Points, column: FloatArray) -> bool:
        """Return whether a coefficient, of values (n,) at points, is no formula."""
        return Coefficient.fit(points, column, self.products) is None

    def _terms(self, rows: LearntRows) -> tuple[StateSignals, Structure]:
        """Find the terms, with positions of switches where there are none without."""

        def terms(signals: StateSignals, lacked: str) -> Structure:
            states = rows.states(signals)
            return Structure.of(signals, states, lacked, lambda name: self.think_of(f"terms of {name}"))

        signals = rows.hidden.as_inputs()
        structure = terms(signals, self._lacked)
        switches = tuple(rows.switches.known())
        while structure.lacking and switches:
            switching = with_switches(signals, switches)
            switched = terms(switching, structure.lacking)
            if switched.lacking:
                break
            # What no term has needs no rule.
            used = switched.used()
            needed = tuple(name for place, name in enumerate(switches, len(signals.states)) if place in used)
            if needed == switches:
                return switching, switched
            switches = needed
        return signals, structure

    def _with_course(self, equations: StateEquations, points: Points, x: FloatArray) -> StateEquations:
        """Find what hidden inputs do between the outputs; return equations that follow it."""
        self.think_of("what inputs inside the FMU do between the outputs")
        signals = self.signals
        n_declared = signals.n_declared
        some = spread(len(x), LEAST_TO_LEARN)
        points, x = points.part(some), x[some]
        # A jump placed 20 minutes wrong, of 30, left 8 % of the residuals' squares, and
        # equations were not believed (docs/notes/state-equations.md, Weather inside the FMU).
        course = Course(signals.at_outputs[:, n_declared:], signals.every)
        least, before = equations.missed(points, x), np.inf
        while least < BETTER_COURSE * before:
            before = least
            # Signal by signal until nothing changes: combinations of all their places would be too many.
            for hidden in range(signals.n_hidden):
                for other in course.others(hidden):
                    driven = np.concatenate([signals.driven[:, :n_declared], other.driven], axis=1)
                    changed = equations.with_signals(replace(signals, driven=driven))
                    missed = changed.missed(points, x)
                    if missed < BETTER_COURSE * least:
                        equations, course, least = changed, other, missed
        self._has_course, self.signals = True, equations.signals
        return equations
