"""Which terms state equations may have: sums of states, inputs, their differences, products and functions.

A derivative is sought as a sum of few terms, each a state or an input, or the difference of one to the state
itself where both have the same unit (heat flows between temperatures do), alone or times an input without
unit (a switch). Where these do not suffice, products of two or three and fourth powers of temperatures are
looked at, too, and then functions of a state, an input or a difference.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement, islice
from typing import NamedTuple

import numpy as np

from simulation.arrays import FloatArray, IntArray
from studies.calibration.state_equations.states import StateSignals

# Terms are chosen by so many rows, at so many times.
N_CHOICE_ROWS, N_CHOICE_TIMES = 8, 400
DIMENSIONLESS, TEMPERATURE, ANGLE = ("", "1"), "K", ("", "1", "rad")
# Products beyond are not looked at.
# Among hundreds of terms some fit nearly any signal that
# moves little (docs/notes/state-equations.md, Whole powers).
MOST_CANDIDATES = 800

# Added to a size that is divided by: the smallest number with all digits.
TINY = float(np.finfo(float).tiny)

# Exponentials and saturations are missing, as their places are parameters (the same note, Functions and
# compiled steps). Functions have the sign of their argument where a flow turns with its difference.
FUNCTIONS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "root": lambda v: np.sign(v) * np.sqrt(np.abs(v)),
    "square": lambda v: v * np.abs(v),
    # Heat transfer by turbulent natural convection: a coefficient
    # that grows with the cube root of the difference.
    "natural convection": lambda v: v * np.cbrt(np.abs(v)),
    "magnitude": np.abs,
    "sine": np.sin,
    "cosine": np.cos,
}
"""Functions that equations of flows, drag, natural convection, friction and angles are made of."""

OF_ANGLES = ("sine", "cosine")


class Term(NamedTuple):
    """One term, times a coefficient.

    Attributes:
        column: Position among the states and then the inputs; -1 for the constant.
        is_difference: Whether it is the difference to the state itself.
        factors: Positions of what it is multiplied with.
        function: Name of the function that is taken before that, "" for none.
    """

    column: int
    is_difference: bool = False
    factors: tuple[int, ...] = ()
    function: str = ""

    def values(self, x: FloatArray, inputs: FloatArray, own: int) -> FloatArray:
        """Return the term over time.

        Args:
            x: States. Shape (..., t, s).
            inputs: Shape (t, q).
            own: Position of the state itself.

        Returns:
            Shape (..., t), or (t,) of inputs alone.
        """
        n_states = x.shape[-1]

        def column(place: int) -> FloatArray:
            return x[..., place] if place < n_states else inputs[..., place - n_states]

        values = column(self.column) if self.column >= 0 else np.ones(len(inputs))
        if self.is_difference:
            values = values - x[..., own]
        if self.function:
            values = FUNCTIONS[self.function](values)
        for factor in self.factors:
            values = values * column(factor)
        return values


@dataclass(frozen=True, eq=False)
class Sum:
    """A derivative or an output as a sum of terms.

    Attributes:
        own: Position of the state whose derivative it is, -1 for an output.
        terms: Its terms.
    """

    own: int
    terms: tuple[Term, ...]

    def values(self, x: FloatArray, inputs: FloatArray) -> FloatArray:
        """Return the terms over time: states (..., t, s), inputs (t, q). Shape (..., t, f)."""
        values = np.empty((*x.shape[:-1], len(self.terms)))
        for place, term in enumerate(self.terms):
            values[..., place] = term.values(x, inputs, max(self.own, 0))
        return values


def candidates(signals: StateSignals, own: int) -> list[Term]:
    """Return the terms that a sum may have, the constant last.

    Args:
        signals: What is known of the states.
        own: Position of the state whose derivative the sum is, -1 for an output.
    """
    n_states, columns = len(signals.states), _allowed(signals, own)
    if own < 0:
        return [*(Term(column) for column in columns), Term(-1)]
    # Heat flows between temperatures: one difference instead of two terms with opposite coefficients.
    plain = [Term(column, signals.units[column] == signals.units[own]) for column in columns if column != own]
    switches = [one for one in columns if one >= signals.n_continuous and signals.units[one] in DIMENSIONLESS]
    # Hidden inputs without unit may be dozens; those that switch have two values.
    if len(switches) * len(plain) > MOST_CANDIDATES and signals.n_hidden:
        switches = [one for one in switches if len(np.unique(signals.at_outputs[:, one - n_states])) <= 2]
    switched = [
        term._replace(factors=(switch,)) for switch in switches for term in plain if term.column != switch
    ]
    return [*plain, *switched, Term(own), Term(-1)]


def candidates_without_switches(signals: StateSignals, own: int) -> list[Term]:
    """Return the same, none of them times an input without unit."""
    return [term for term in candidates(signals, own) if not term.factors]


def candidates_with_products(signals: StateSignals, own: int) -> list[Term]:
    """Return the same and products, as far as they are few.

    A difference is multiplied with what has another unit, as temperatures are with a flow. What has no unit
    is multiplied as it is. Of temperatures there are no products, but fourth powers (radiation).
    """
    units, n_states = signals.units, len(signals.states)
    columns = sorted({*_allowed(signals, own), own} - {-1})
    is_alike = [own >= 0 and unit == units[own] and unit not in DIMENSIONLESS for unit in units]
    # Differences without unit would make an oscillator's
    # coefficient a difference (the same note, Whole powers).
    simple = [
        term
        for term in candidates(signals, own)
        if not (term.is_difference and units[term.column] in DIMENSIONLESS)
    ]
    found = [
        *(Term(one) for one in columns if units[one] in DIMENSIONLESS and one != own and own >= 0),
        *simple[:-1],
        *(Term(one, factors=(one,) * 3) for one in columns if units[one] == TEMPERATURE),
    ]
    products = [
        [
            Term(one, is_difference=True, factors=(other,))
            for one in columns
            for other in columns
            if is_alike[one] and one != own and not is_alike[other]
        ]
    ]
    states = [one for one in columns if one < n_states]
    for degree, among in ((2, columns), (3, states)):
        monomials = (
            Term(chosen[0], factors=chosen[1:])
            for chosen in combinations_with_replacement(among, degree)
            if sum(units[one] == TEMPERATURE for one in chosen) < 2
        )
        # With 64 states there are 45,760 products of three: islice makes no more than can be used.
        products.append(list(islice(monomials, MOST_CANDIDATES)))
    for terms in products:
        # All of a kind or none: a part of them would depend
        # on the order in which the FMU names its variables.
        if len(found) + len(terms) < MOST_CANDIDATES:
            found += terms
    # dict.fromkeys drops what is there twice and, unlike a set, leaves the order as it is.
    return [*dict.fromkeys(found), Term(-1)]


def candidates_with_functions(signals: StateSignals, own: int) -> list[Term]:
    """Return the same and functions, also times an input without unit (a valve), as far as they are few."""
    units, n_states = signals.units, len(signals.states)
    columns = sorted({*_allowed(signals, own), own} - {-1})
    alone = [
        Term(one, is_difference, function=name)
        for name in FUNCTIONS
        for one in columns
        for is_difference in (False, True)
        if not is_difference or (own >= 0 and one != own and units[one] == units[own])
        # Sines of what is no angle mean nothing, and fewer candidates fit less by chance.
        if name not in OF_ANGLES or units[one] in ANGLE
    ]
    opened = [
        term._replace(factors=(one,))
        for one in columns
        if one >= n_states and units[one] in DIMENSIONLESS
        for term in alone
        if term.column != one
    ]
    found = candidates_with_products(signals, own)[:-1]
    for terms in (alone, opened):
        if len(found) + len(terms) < MOST_CANDIDATES:
            found += terms
    return [*found, Term(-1)]


def _allowed(signals: StateSignals, own: int) -> list[int]:
    """Return the positions of the states and inputs that a sum may depend on."""
    allowed = signals.depends_on[own] if own >= 0 else None
    names = (*signals.states, *signals.inputs)
    n_declared = len(signals.states) + signals.n_declared
    return [
        column
        for column, name in enumerate(names)
        # Hidden inputs are no inputs of the FMU, so that its declared dependencies do not name them.
        if allowed is None or name in allowed or column >= n_declared
    ]


def spread(n: int, most: int) -> IntArray:
    """Return at most so many of the positions 0 to n - 1, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))
