"""State equations learnt from simulations: a model's trajectories all over the box, from a few of its rows.

    dx_j/dt = sum_k a_jk(theta) f_jk(x, u),    y = sum_k c_k(theta) g_k(x, u).

The terms f and g are states and inputs, their differences, products and functions (terms.py). Which of
them they are is found in what the states did (term_choice.py), and each one's coefficient is learnt over the
parameters (coefficient.py). Trajectories are curved in many ways where coefficients are not: from ten rows
of an office with 14 parameters its trajectories are known about as well as from a thousand by a surrogate
that knows outputs alone. The rows show whether a model follows such equations.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.state_equations.coefficient import Coefficient, Points, formulas, values
from studies.calibration.state_equations.flow import LinearFlow, SteppedFlow
from studies.calibration.state_equations.product_forms import Products, shortest_product
from studies.calibration.state_equations.states import StateRows, StateSignals
from studies.calibration.state_equations.switch_rules import switch_rules
from studies.calibration.state_equations.term_choice import Fit, chosen_terms, fitted
from studies.calibration.state_equations.terms import (
    N_CHOICE_ROWS,
    N_CHOICE_TIMES,
    TINY,
    Sum,
    Term,
    candidates,
    candidates_with_functions,
    candidates_with_products,
    candidates_without_switches,
    spread,
)

# Sum of squares, as a share of all, that equations of a model that moves so leave: at least, and at most
# where the error of the FMU's solver leaves more.
LEARNT, MOST_LEFT = 1e-9, 1e-6
# The same of products, of which there are so many that some fit nearly whatever moves little.
# An outdoor surface of the white box was fitted to 1e-10
# by chance (docs/notes/state-equations.md, Whole powers).
PRODUCTS_LEARNT = 1e-14
# Standard deviation of a coefficient, as a share of itself, up to which a row determines it.
SURE = 1e-5
# Rows in which changes of switches are located: a row takes some 20 ms.
MOST_RULE_ROWS = 16
# States at all steps that are held in memory at once.
# 32 MB, at 8 bytes each.
MOST_VALUES = 4_000_000


NO_FORMULAS = "not all coefficients are formulas of the parameters"


@dataclass(frozen=True, eq=False)
class Structure:
    """Which terms the equations have; make it with `of`.

    Attributes:
        sums: Of the s derivatives, then of the k outputs.
        misfit: Greatest share of squares that one of them leaves. [1]
        lacking: The variable for which none was found, "" for none.
        most_left: What one of them may leave, by the tolerance of the FMU's solver. [1]
    """

    sums: tuple[Sum, ...]
    misfit: float
    lacking: str = ""
    most_left: float = LEARNT

    @classmethod
    def of(
        cls,
        signals: StateSignals,
        rows: StateRows,
        lacked: str = "",
        think_of: Callable[[str], None] = lambda what: None,
    ) -> Self:
        """Find the terms.

        Args:
            signals: What is known of the states.
            rows: What they and the outputs did.
            lacked: The variable for which none was found in fewer rows, "" for none: it is looked at first.
            think_of: Called with each variable's name before its terms are looked for.
        """
        sums, worst = dict[int, Sum](), 0.0
        # A part of the rows, at a part of the times, is enough to find the terms.
        some, times = spread(len(rows.x), N_CHOICE_ROWS), spread(rows.x.shape[1] - 1, N_CHOICE_TIMES)
        x, inputs = rows.x[np.ix_(some, 1 + times)], signals.at_outputs[1 + times]
        owns = [*range(len(signals.states)), *[-1] * rows.y.shape[-1]]
        names = (*signals.derivatives, *signals.outputs)
        targets = _targets(rows)
        # Most models that follow no such equations lack the same variable again: nothing else is tried.
        for place in sorted(range(len(owns)), key=lambda place: names[place] != lacked):
            think_of(names[place])
            target = targets[place][np.ix_(some, times)]
            found, misfit = _sum(signals, owns[place], x, inputs, target)
            if not found.terms:
                return cls((), misfit, names[place])
            sums[place] = found
            worst = max(worst, misfit)
        most = max(most_left(signals, own, x) for own in owns)
        return cls(tuple(sums[place] for place in range(len(owns))), worst, most_left=most)

    def why_not(self, signals: StateSignals) -> str:
        """Say for which variable no sum was found, and what was offered."""
        return (
            f"no sum of states, inputs, products and functions makes up {self.lacking}: the best leaves "
            f"{self.misfit:.2g} of its squares (declared inputs: {signals.n_declared}; other variables that "
            f"follow time alone: {signals.n_hidden})"
        )

    def of_used(self, signals: StateSignals) -> tuple[StateSignals, Self]:
        """Return signals without the hidden inputs that no term has, and the structure of those."""
        n_states = len(signals.states)
        hidden = sorted(place for place in self.used() if place >= n_states + signals.n_declared)
        kept = [*range(n_states + signals.n_declared), *hidden]
        place_of = {place: rank for rank, place in enumerate((-1, *kept), -1)}

        def moved(term: Term) -> Term:
            factors = tuple(place_of[place] for place in term.factors)
            return term._replace(column=place_of[term.column], factors=factors)

        sums = tuple(replace(one, terms=tuple(map(moved, one.terms))) for one in self.sums)
        return signals.with_hidden([place - n_states for place in hidden]), replace(self, sums=sums)

    def used(self) -> set[int]:
        """Return the positions among states and inputs that terms have."""
        return {place for one in self.sums for term in one.terms for place in (term.column, *term.factors)}

    def fits(self, signals: StateSignals, rows: StateRows) -> list[tuple[Fit, ...]]:
        """Fit the coefficients of every row; return those of all sums for each.

        Args:
            signals: What is known of the states.
            rows: What they and the outputs did.
        """
        by_sum = list[list[Fit]]()
        for one, target in zip(self.sums, _targets(rows), strict=True):
            values = one.values(rows.x[:, 1:], signals.at_outputs[1:])
            by_sum.append([fitted(value, goal) for value, goal in zip(values, target, strict=True)])
        return list(zip(*by_sum, strict=True))

    @staticmethod
    def coefficients(by_row: Sequence[tuple[Fit, ...]]) -> tuple[list[FloatArray], float]:
        """Return the coefficients of every row.

        Args:
            by_row: What `fits` returned.

        Returns:
            Coefficients of every sum, shapes (n, terms), NaN where a row leaves them open, and the greatest
            share of squares that is left. [1]
        """
        found, worst = list[FloatArray](), 0.0
        for fits in zip(*by_row, strict=True):
            deviation = np.array([fit.deviation for fit in fits])
            # In some rows one state follows another so closely that their terms cannot be separated.
            # A wall may follow the weather at once. With such coefficients, 4 of 45
            # runs took 32 to 36 calls (docs/notes/state-equations.md, First form).
            is_open = deviation > np.maximum(SURE, np.median(deviation, axis=0))
            found.append(np.where(is_open, np.nan, np.array([fit.found for fit in fits])))
            worst = max([worst, *(fit.left if np.isfinite(fit.left) else np.inf for fit in fits)])
        return found, worst


def most_left(signals: StateSignals, own: int, x: FloatArray) -> float:
    """Return the share of squares that a sum of terms may leave where the solver's error does. [1].

    Args:
        signals: What is known of the states.
        own: Position of the state whose derivative it is, -1 for an output.
        x: States. Shape (n, t, s). [FMU's units]
    """
    if own < 0 or not signals.tolerance:
        return LEARNT
    moved = x[..., own].std(axis=1) + TINY
    # The solver's error is relative to a state's size, what equations leave is relative to how it moves.
    error = signals.tolerance * np.abs(x[..., own]).max(axis=1) / moved
    return float(np.clip(np.median(error) ** 2, LEARNT, MOST_LEFT))


def _sum(
    signals: StateSignals, own: int, x: FloatArray, inputs: FloatArray, target: FloatArray
) -> tuple[Sum, float]:
    """Find the terms of a state's derivative or, where own is -1, an output, and what they leave.

    Returns:
        The terms, none where none make it up, and the least share of squares that any have left. [1]
    """
    declared = signals.with_hidden([])
    enough = most_left(signals, own, x)
    # Few candidates go first, and declared inputs before
    # hidden ones: the more there are, the more fit by chance.
    sums, others = [(declared, candidates, enough)], [candidates_with_products, candidates_with_functions]
    curved = [(declared, offered, PRODUCTS_LEARNT) for offered in others]
    if signals.n_hidden:
        # Of many hidden inputs some sum may leave little by chance: better ones are looked for.
        sums += [(signals, candidates_without_switches, PRODUCTS_LEARNT), (signals, candidates, enough)]
        curved += [(signals, offered, PRODUCTS_LEARNT) for offered in others]
    least = np.inf
    for stages, worst in ((sums, enough), (curved, PRODUCTS_LEARNT)):
        best = Sum(own, ())
        for among, offered, at_once in stages:
            terms = offered(among, own)
            chosen, misfit = chosen_terms(terms, Sum(own, tuple(terms)).values(x, inputs), target)
            if misfit < least:
                best, least = Sum(own, tuple(terms[one] for one in chosen)), misfit
            if misfit <= at_once:
                break
        if least <= worst and best.terms:
            return best, least
    return Sum(own, ()), least


def _flow(signals: StateSignals, structure: Structure) -> LinearFlow | SteppedFlow:
    derivatives = structure.sums[: len(signals.states)]
    if signals.n_switches:
        return SteppedFlow(signals, derivatives)
    return LinearFlow.of(signals, derivatives) or SteppedFlow(signals, derivatives)


def _targets(rows: StateRows) -> list[FloatArray]:
    """Return what the sums are fitted to, derivatives and outputs after the first time. Shapes (n, t - 1)."""
    return [*np.moveaxis(rows.slope[:, 1:], -1, 0), *np.moveaxis(rows.y[:, 1:], -1, 0)]


@dataclass(frozen=True, eq=False)
class StateEquations:
    """A model's state equations over its box; make them with `learn`.

    Attributes:
        signals: What is known of the states.
        structure: Their terms.
        by_term: Coefficients of every sum, in the order of its terms.
        start: States at the first output that is watched.
        flow: Solves them.
        limits: Thresholds of switches, and shortest times between their changes, see `switch_rules`.
    """

    signals: StateSignals
    structure: Structure
    by_term: tuple[tuple[Coefficient, ...], ...]
    start: tuple[Coefficient, ...]
    flow: LinearFlow | SteppedFlow
    limits: tuple[Coefficient, ...] = ()

    @classmethod
    def learn(
        cls,
        signals: StateSignals,
        structure: Structure,
        points: Points,
        x: FloatArray,
        found: Sequence[FloatArray],
        products: Products,
    ) -> Self | str:
        """Learn coefficients and start states over the parameters.

        Args:
            signals: What is known of the states.
            structure: The terms.
            points: The rows.
            x: States, from the first output that is watched. Shape (n, t, s). [FMU's units]
            found: Coefficients of every row, from `Structure.coefficients`.
            products: Of the box's parameters.

        Returns:
            The equations, or in words why there are none.
        """
        by_term = list[tuple[Coefficient, ...]]()
        for table in (*found, x[:, 0]):
            if (known := formulas(points, table, products)) is None:
                return NO_FORMULAS
            by_term.append(known)
        start = by_term.pop()
        flow = _flow(signals, structure)
        equations = cls(signals, structure, tuple(by_term), start, flow)
        # Matrix exponentials are exact: no step has to be refined.
        if isinstance(flow, LinearFlow):
            return equations
        if flow.unsolved:
            return f'the function "{flow.unsolved}" has no compiled steps'
        if signals.n_switches:
            switched = equations._with_rules(points, x, products)
            if isinstance(switched, str):
                return switched
            equations = switched
        some = points.part(spread(len(points.x), N_CHOICE_ROWS))
        assert isinstance(equations.flow, SteppedFlow), "linear equations were returned above"
        with np.errstate(all="ignore"):
            fine = equations.flow.fine_enough(values(start, some).T, equations._rates(some))
        return "they move too fast to be solved in time" if fine is None else replace(equations, flow=fine)

    def _with_rules(self, points: Points, x: FloatArray, products: Products) -> Self | str:
        """Learn when switches change, from the rows' states (n, t, s); say why not in words."""
        some = spread(len(x), MOST_RULE_ROWS)
        points, derivatives = points.part(some), self.structure.sums[: len(self.signals.states)]
        found = switch_rules(self.signals, derivatives, x[some], self._rates(points))
        if isinstance(found, str):
            return found
        rules, by_row = found
        limits = formulas(points, by_row, products)
        if limits is None:
            return "a switch changes at no threshold that was found"
        flow = SteppedFlow(self.signals, derivatives, rules)
        return replace(self, flow=flow, limits=limits)

    def with_signals(self, signals: StateSignals) -> Self:
        """Return the same equations where signals of the same names take another course."""
        flow = _flow(signals, self.structure)
        # Fixed parts of a step, so that courses of inputs are compared with each other, and not their steps.
        if isinstance(self.flow, SteppedFlow):
            flow = replace(self.flow, signals=signals, sums=flow.sums)
        return replace(self, signals=signals, flow=flow)

    def in_experiment(
        self, signals: StateSignals, changed: Sequence[tuple[float, float]]
    ) -> tuple[Self, list[tuple[float, float]]] | None:
        """Return the equations as another experiment with the same model follows them.

        Args:
            signals: What is known of its states.
            changed: Values that are fixed, here and there, where they differ. [FMU's units]

        Returns:
            The equations, and those of the changed values at which no state begins: what they do there, no
            row has shown. None where rows of this experiment do not say what the equations are there.
        """
        mine = self.signals
        if mine.n_hidden or mine.n_switches:
            return None
        # What an input does is unknown where it rests, unless it rests there, too.
        rests = (mine.driven == mine.driven[0]).all(axis=0)
        if (rests & (signals.driven != mine.driven[0]).any(axis=0)).any():
            return None
        start, known = list(self.start), [one.fixed_value for one in self.start]
        unknown = list[tuple[float, float]]()
        for here, there in changed:
            # A fixed value may be where states begin.
            places = [
                k for k, value in enumerate(known) if value is not None and np.isclose(value, here, 1e-9, 0)
            ]
            if len({one for mine, one in changed if np.isclose(mine, here, 1e-9, 0)}) > 1:
                return None
            if not places:
                unknown.append((here, there))
            for place in places:
                start[place] = Coefficient(0.0, there)
        moved = replace(self, start=tuple(start)).with_signals(signals)
        return (moved, unknown) if type(moved.flow) is type(self.flow) else None

    def with_effect(self, points: Points, rows: StateRows, amount: float, products: Products) -> Self | None:
        """Return the equations with what the change of a fixed value adds to them, as one row shows it.

        What it adds is sought as few terms, each the change times a product of parameters: a door of 40 W/K
        adds 40 / C times a difference of temperatures.

        Args:
            points: Where the row is. One point.
            rows: What states and outputs did there.
            amount: The change. [FMU's unit]
            products: Of the box's parameters.

        Returns:
            The equations, None where the row shows something else.
        """
        sums, by_term, signals = list(self.structure.sums), list(self.by_term), self.signals
        x, inputs = rows.x[:, 1:], signals.at_outputs[1:]
        for place, (one, table, target) in enumerate(zip(sums, by_term, _targets(rows), strict=True)):
            rest = target - np.einsum("ntf,nf->nt", one.values(x, inputs), values(table, points))
            enough = most_left(signals, one.own, x) * np.square(target).sum()
            if np.square(rest).sum() <= enough:
                continue
            terms = candidates(signals, one.own)
            offered = Sum(one.own, tuple(terms)).values(x, inputs)
            chosen, left = chosen_terms(terms, offered, rest)
            fit = fitted(offered[0][:, chosen], rest[0])
            found = [shortest_product(products, points.theta[0], value, amount) for value in fit.found]
            if left * np.square(rest).sum() > enough or None in found:
                return None
            sums[place] = replace(one, terms=(*one.terms, *(terms[k] for k in chosen)))
            by_term[place] = (*table, *(Coefficient(0.0, 0.0, formula=formula) for formula in found))
        structure = replace(self.structure, sums=tuple(sums))
        added = replace(self, structure=structure, by_term=tuple(by_term)).with_signals(signals)
        return added if type(added.flow) is type(self.flow) else None

    def until(self, n_outputs: int) -> Self:
        """Return the same stepped equations over the first reported outputs alone."""
        assert isinstance(self.flow, SteppedFlow), "matrix exponentials are solved over all outputs"
        n = self.signals.n_before + n_outputs
        signals = replace(
            self.signals,
            driven=self.signals.driven[: (n - 1) * self.signals.every],
            seen=None if self.signals.seen is None else self.signals.seen[:n],
        )
        return replace(self, signals=signals, flow=replace(self.flow, signals=signals))

    def missed(self, points: Points, x: FloatArray) -> float:
        """Return how solved states differ from simulated ones (n, t, s), as a share of their squares. [1]."""
        with np.errstate(all="ignore"):
            error = np.square(self._states(points) - x).mean(axis=1)
            # By its variance: the level of a temperature in K would hide all errors.
            share = float((error / (x.var(axis=1) + TINY)).mean())
        return share if np.isfinite(share) else np.inf

    def outputs(self, points: Points) -> FloatArray:
        """Solve the equations.

        Args:
            points: n points.

        Returns:
            Reported outputs, not finite where the equations run away. Shape (n, t, k). [per output]
        """
        return np.concatenate([self._outputs(piece) for piece in self._pieces(points)])

    def reach(self, points: Points) -> tuple[FloatArray, FloatArray]:
        """Return the least and the greatest value of every state at points. Shapes (n, s). [FMU's units]."""
        found = [(x.min(axis=1), x.max(axis=1)) for x in map(self._states, self._pieces(points))]
        least, greatest = (np.concatenate(ends) for ends in zip(*found, strict=True))
        return least, greatest

    def _pieces(self, points: Points) -> Iterator[Points]:
        """Yield points in pieces of so many that the states of a long simulation fit into memory."""
        per_point = len(self.signals.driven) * len(self.signals.states)
        n_at_once = max(MOST_VALUES // per_point, 1)
        for first in range(0, len(points.x), n_at_once):
            yield points.part(slice(first, first + n_at_once))

    def _states(self, points: Points) -> FloatArray:
        """Solve the equations; return the states at all watched outputs. Shape (n, t, s). [FMU's units]."""
        return self.flow.states(values(self.start, points).T, self._rates(points))

    def coefficients(self, points: Points) -> FloatArray:
        """Return all coefficients and first states. Shape (n, c)."""
        return np.concatenate(
            [values(table, points) for table in (*self.by_term, self.start, self.limits)], axis=1
        )

    def _outputs(self, points: Points) -> FloatArray:
        with np.errstate(all="ignore"):
            states = self._states(points)
            n_states = len(self.signals.states)
            inputs = self.signals.at_outputs
            answers = [
                np.einsum("ntf,nf->nt", one.values(states, inputs), values(table, points))
                for one, table in zip(self.structure.sums[n_states:], self.by_term[n_states:], strict=True)
            ]
        return np.stack(answers, axis=-1)[:, self.signals.n_before :]

    def _rates(self, points: Points) -> list[FloatArray]:
        """Return the coefficients of every derivative, shapes (n, terms), and of switches, (n, 2 r)."""
        tables = (*self.by_term[: len(self.signals.states)], self.limits)
        return [values(table, points) for table in tables if table]
