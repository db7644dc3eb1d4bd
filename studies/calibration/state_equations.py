"""State equations learnt from simulations: a model's trajectories all over the box, from a few of its rows.

    dx_j/dt = sum_k a_jk(theta) f_jk(x, u),    y = sum_k c_k(theta) g_k(x, u).

The terms f and g are states and inputs, their differences, products and functions (state_terms.py). Which of
them they are is found in what the states did (term_choice.py), and each one's coefficient is learnt over the
parameters (coefficient.py). Trajectories bend in many ways where coefficients do not: ten rows of an office
with 14 parameters tell its trajectories about as well as a thousand tell a surrogate that knows outputs
alone. Whether a model moves so, the rows say.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.coefficient import Coefficient, Points
from studies.calibration.product_laws import Products
from studies.calibration.state_flow import LinearFlow, SteppedFlow
from studies.calibration.state_terms import (
    N_ROWS,
    N_TIMES,
    Sum,
    candidates,
    candidates_with_functions,
    candidates_with_products,
    spread,
)
from studies.calibration.states import StateRows, StateSignals
from studies.calibration.term_choice import chosen_terms, fitted

# Sum of squares, as a share of all, that equations of a model that moves so leave.
LEARNT = 1e-9
# The same of products, of which there are so many that some fit nearly whatever moves little.
PRODUCTS_LEARNT = 1e-14
# Standard deviation of a coefficient, as a share of itself, up to which a row tells it.
SURE = 1e-5
# Rows below which nothing is looked for.
LEAST_TO_LEARN = 4
# States at all steps that are held in memory at once.
MOST_VALUES = 4_000_000


@dataclass(frozen=True, eq=False)
class Structure:
    """Which terms the equations have; make it with `of`.

    Attributes:
        sums: Of the s derivatives, then of the k outputs.
        misfit: Greatest share of squares that one of them leaves, infinite where one was not found. [1]
    """

    sums: tuple[Sum, ...]
    misfit: float

    @classmethod
    def of(cls, signals: StateSignals, rows: StateRows) -> Self:
        """Find the terms.

        Args:
            signals: What is known of the states.
            rows: What they and the outputs did.
        """
        sums, worst = list[Sum](), 0.0
        # A part of the rows, at a part of the times, tells the terms.
        some, times = spread(len(rows.x), N_ROWS), spread(rows.x.shape[1] - 1, N_TIMES)
        x, inputs = rows.x[np.ix_(some, 1 + times)], signals.at_outputs[1 + times]
        owns = [*range(len(signals.states)), *[-1] * rows.y.shape[-1]]
        for own, target in zip(owns, _targets(rows), strict=True):
            found, misfit = _sum(signals, own, x, inputs, target[np.ix_(some, times)])
            sums.append(found)
            worst = max(worst, misfit)
            if worst > LEARNT:
                break
        return cls(tuple(sums), worst)

    def fitted(self, signals: StateSignals, rows: StateRows) -> tuple[list[FloatArray], float]:
        """Fit the coefficients of every row.

        Args:
            signals: What is known of the states.
            rows: What they and the outputs did.

        Returns:
            Coefficients of every sum, shapes (n, terms), NaN where a row leaves them open, and the greatest
            share of squares that is left. [1]
        """
        found, worst = list[FloatArray](), 0.0
        for one, target in zip(self.sums, _targets(rows), strict=True):
            values = one.values(rows.x[:, 1:], signals.at_outputs[1:])
            fits = [fitted(value, goal) for value, goal in zip(values, target, strict=True)]
            doubt = np.array([fit.doubt for fit in fits])
            # In some rows one state follows another so closely that their terms cannot be told apart.
            is_open = doubt > np.maximum(SURE, np.median(doubt, axis=0))
            found.append(np.where(is_open, np.nan, np.array([fit.found for fit in fits])))
            worst = max([worst, *(fit.left if np.isfinite(fit.left) else np.inf for fit in fits)])
        return found, worst


def _sum(
    signals: StateSignals, own: int, x: FloatArray, inputs: FloatArray, target: FloatArray
) -> tuple[Sum, float]:
    """Find the terms of a state's derivative or, where own is -1, an output, and what they leave."""
    for offered, enough in (
        (candidates, LEARNT),
        (candidates_with_products, PRODUCTS_LEARNT),
        (candidates_with_functions, PRODUCTS_LEARNT),
    ):
        terms = offered(signals, own)
        chosen, misfit = chosen_terms(terms, Sum(own, tuple(terms)).values(x, inputs), target)
        if misfit <= enough:
            return Sum(own, tuple(terms[one] for one in chosen)), misfit
    return Sum(own, ()), np.inf


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
        is_exact: Whether all of that are laws, told by enough rows.
    """

    signals: StateSignals
    structure: Structure
    by_term: tuple[tuple[Coefficient, ...], ...]
    start: tuple[Coefficient, ...]
    flow: LinearFlow | SteppedFlow
    is_exact: bool

    @classmethod
    def learn(
        cls,
        signals: StateSignals,
        structure: Structure,
        points: Points,
        starts: FloatArray,
        found: Sequence[FloatArray],
        products: Products,
    ) -> Self | None:
        """Learn coefficients and start states over the parameters.

        Args:
            signals: What is known of the states.
            structure: The terms.
            points: The rows.
            starts: States at the first output that is watched. Shape (n, s). [FMU's units]
            found: Coefficients of every row, from `Structure.fitted`.
            products: Of the box's parameters.

        Returns:
            The equations, None where they cannot be solved in steps of reasonable length.
        """
        by_term = tuple(
            tuple(Coefficient.fit(points, column, products) for column in table.T) for table in found
        )
        start = tuple(Coefficient.fit(points, column, products) for column in starts.T)
        is_exact = all(one.is_exact for table in (*by_term, start) for one in table)
        is_told = all((np.isfinite(table).sum(axis=0) >= LEAST_TO_LEARN).all() for table in found)
        derivatives = structure.sums[: len(signals.states)]
        flow = LinearFlow.of(signals, derivatives) or SteppedFlow(signals, derivatives)
        equations = cls(signals, structure, by_term, start, flow, is_exact and is_told)
        if isinstance(flow, LinearFlow):
            return equations
        some = points.part(spread(len(points.x), N_ROWS))
        with np.errstate(all="ignore"):
            fine = flow.fine_enough(equations._at_start(some), equations._rates(some))
        return None if fine is None else replace(equations, flow=fine)

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
        found = [
            (states.min(axis=1), states.max(axis=1))
            for states in (self._states(piece) for piece in self._pieces(points))
        ]
        return np.concatenate([least for least, _ in found]), np.concatenate([most for _, most in found])

    def _pieces(self, points: Points) -> Iterator[Points]:
        """Yield points in pieces of so many that the states of a long simulation fit into memory."""
        per_point = len(self.signals.driven) * len(self.signals.states)
        n_at_once = max(MOST_VALUES // per_point, 1)
        for first in range(0, len(points.x), n_at_once):
            yield points.part(slice(first, first + n_at_once))

    def _states(self, points: Points) -> FloatArray:
        """Solve the equations; return the states at all watched outputs. Shape (n, t, s). [FMU's units]."""
        return self.flow.states(self._at_start(points), self._rates(points))

    def coefficients(self, points: Points) -> FloatArray:
        """Return all coefficients and first states. Shape (n, c)."""
        by_sum = [self._at(j, points) for j in range(len(self.by_term))]
        return np.concatenate([*by_sum, self._at_start(points).T], axis=1)

    def _outputs(self, points: Points) -> FloatArray:
        with np.errstate(all="ignore"):
            states = self._states(points)
            n_states = len(self.signals.states)
            inputs = self.signals.at_outputs
            answers = [
                np.einsum("ntf,nf->nt", one.values(states, inputs), self._at(j, points))
                for j, one in enumerate(self.structure.sums)
                if j >= n_states
            ]
        return np.stack(answers, axis=-1)[:, self.signals.n_before :]

    def _at(self, j: int, points: Points) -> FloatArray:
        """Return the coefficients of sum j. Shape (n, terms)."""
        return np.stack([one.at(points) for one in self.by_term[j]], axis=-1)

    def _rates(self, points: Points) -> list[FloatArray]:
        """Return the coefficients of every derivative, shapes (n, terms)."""
        return [self._at(j, points) for j in range(len(self.signals.states))]

    def _at_start(self, points: Points) -> FloatArray:
        """Return the first states. Shape (s, n)."""
        return np.stack([one.at(points) for one in self.start])
