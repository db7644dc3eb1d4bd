"""Which terms make up a model's state equations: sparse regression of derivatives on states and inputs.

A derivative is sought as a sum of few terms, each a state or an input, or the difference of one to the state
itself where both have the same unit (heat flows between temperatures do), alone or times an input without
unit (a switch). Where these do not suffice, products of two or three and fourth powers of temperatures are
looked at, too, and then functions of a state, an input or a difference. The derivatives that an FMU answers
belong exactly to the states that it answers, so terms are complete where next to nothing is left. The search
is orthogonal least squares (Chen, Billings and Luo 1989, doi:10.1080/00207178908953472) over several
simulations at once, as in the sparse identification of dynamics (Brunton, Proctor and Kutz 2016,
doi:10.1073/pnas.1517384113).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement, islice
from typing import NamedTuple

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.states import StateSignals

# Sums of squares, as a share of the derivative's, that a complete sum of terms leaves.
COMPLETE = 1e-16
# Above, they are looked for once more.
NEARLY_COMPLETE = 1e-14
# Squared sine between two terms below which they are one.
SAME_TERM = 1e-10
# A term without which less than this is left is none.
NEEDLESS = 1e-10
MOST_TERMS = 16
# Terms are chosen by so many rows, at so many times.
N_ROWS, N_TIMES = 8, 400
DIMENSIONLESS, TEMPERATURE, ANGLE = ("", "1"), "K", ("", "1", "rad")
# Products beyond are not looked at.
MOST_CANDIDATES = 800

FUNCTIONS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "root": lambda v: np.sign(v) * np.sqrt(np.abs(v)),
    "square": lambda v: v * np.abs(v),
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

    def values(self, columns: FloatArray, own: FloatArray) -> FloatArray:
        """Return the term over time.

        Args:
            columns: States and inputs. Shape (..., t, s + q).
            own: The state itself. Shape (..., t).

        Returns:
            Shape (..., t).
        """
        values = columns[..., self.column] if self.column >= 0 else np.ones(columns.shape[:-1])
        if self.is_difference:
            values = values - own
        if self.function:
            values = FUNCTIONS[self.function](values)
        for factor in self.factors:
            values = values * columns[..., factor]
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
        columns = np.concatenate([x, np.broadcast_to(inputs, (*x.shape[:-1], inputs.shape[-1]))], axis=-1)
        own = x[..., max(self.own, 0)]
        return np.stack([term.values(columns, own) for term in self.terms], axis=-1)


def candidates(signals: StateSignals, own: int) -> list[Term]:
    """Return the terms that a sum may have, the constant last.

    Args:
        signals: What is known of the states.
        own: Position of the state whose derivative the sum is, -1 for an output.
    """
    n_states, columns = len(signals.states), _allowed(signals, own)
    if own < 0:
        return [*(Term(column) for column in columns), Term(-1)]
    plain = [Term(column, signals.units[column] == signals.units[own]) for column in columns if column != own]
    switches = [column for column in columns if column >= n_states and signals.units[column] in DIMENSIONLESS]
    switched = [
        term._replace(factors=(switch,)) for switch in switches for term in plain if term.column != switch
    ]
    return [*plain, *switched, Term(own), Term(-1)]


def candidates_with_products(signals: StateSignals, own: int) -> list[Term]:
    """Return the same and products, as far as they are few.

    A difference is multiplied with what has another unit, as temperatures are with a flow. What has no unit
    is multiplied as it is. Of temperatures there are no products, but fourth powers (radiation).
    """
    units, n_states = signals.units, len(signals.states)
    columns = sorted({*_allowed(signals, own), own} - {-1})
    is_alike = [own >= 0 and unit == units[own] and unit not in DIMENSIONLESS for unit in units]
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
        products.append(list(islice(monomials, MOST_CANDIDATES)))
    for terms in products:
        if len(found) + len(terms) < MOST_CANDIDATES:
            found += terms
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
    names = enumerate((*signals.states, *signals.inputs))
    return [column for column, name in names if allowed is None or name in allowed]


def spread(n: int, most: int) -> IntArray:
    """Return at most so many of the positions 0 to n - 1, evenly spread."""
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(np.int64))


@np.errstate(all="ignore")
def chosen_terms(terms: Sequence[Term], values: FloatArray, target: FloatArray) -> tuple[list[int], float]:
    """Choose the fewest terms that make up a target in every row, each row with coefficients of its own.

    They are chosen one after the other; where those are not all, once more from the two that explain most
    together, of which neither may explain much alone.

    Args:
        terms: The f candidates, the last of them the constant.
        values: Their values. Shape (n, t, f).
        target: Shape (n, t).

    Returns:
        Their positions, and what they leave of the target's squares, mean over rows. [1]
    """
    if not target.any():
        return [len(terms) - 1], 0.0
    norm = np.sqrt(np.square(values).sum(axis=1, keepdims=True))
    values = values / np.where(norm > 0.0, norm, 1.0)
    chosen, left = _added(values, target, [])
    if left > NEARLY_COMPLETE and len(terms) > 2:
        again, left_again = _added(values, target, _best_pair(values, target))
        if left_again < left:
            chosen, left = again, left_again
    return chosen, left


def _added(values: FloatArray, target: FloatArray, begun: list[int]) -> tuple[list[int], float]:
    """Add terms to those that are begun with, take needless ones away; return them and what they leave."""
    size = np.square(target).sum(axis=1) + np.finfo(float).tiny
    chosen, left, rest = list[int](), target.copy(), values.copy()
    while len(chosen) < min(MOST_TERMS, values.shape[2], target.shape[1] - 1):
        squares = np.square(rest).sum(axis=1)
        if len(chosen) < len(begun):
            best = begun[len(chosen)]
        else:
            # What is left of a column after those before it is rounding.
            is_new = squares > 1e-20
            along = np.einsum("nt,ntf->nf", left, rest) ** 2
            gain = np.where(is_new, along, 0.0) / np.where(is_new, squares, 1.0)
            share = (gain / size[:, None]).mean(axis=0)
            share[chosen] = -1.0
            best = int(np.argmax(share))
            if share[best] <= 0.0:
                break
        chosen.append(best)
        axis = rest[..., best] / np.sqrt(np.maximum(squares[:, best], 1e-300))[:, None]
        rest = rest - axis[..., None] * np.einsum("nt,ntf->nf", axis, rest)[:, None]
        left = left - axis * np.einsum("nt,nt->n", axis, left)[:, None]
        if unexplained(values, target, chosen) <= COMPLETE:
            break
    chosen = _without_needless(values, target, chosen or [values.shape[2] - 1])
    return chosen, unexplained(values, target, chosen)


def _best_pair(values: FloatArray, target: FloatArray) -> list[int]:
    """Return the two terms (n, t, f) that explain most of a target (n, t) together, mean over rows."""
    explained = np.zeros((values.shape[2],) * 2)
    for columns, goal in zip(values, target, strict=True):
        along = goal @ columns / np.sqrt(goal @ goal + np.finfo(float).tiny)
        cosines = columns.T @ columns
        both = along[:, None] ** 2 + along**2 - 2.0 * np.outer(along, along) * cosines
        squares = 1.0 - cosines**2
        share = np.where(squares > SAME_TERM, both / np.maximum(squares, SAME_TERM), 0.0)
        explained += np.nan_to_num(np.minimum(share, 1.0), nan=0.0)
    first, second = np.unravel_index(int(np.argmax(explained)), explained.shape)
    return [int(first), int(second)] if explained[first, second] > 0.0 else []


class Fit(NamedTuple):
    """Terms fitted to one row.

    Attributes:
        found: Coefficients. Shape (f,).
        doubt: Their standard deviations, as shares of themselves. Shape (f,). [1]
        left: What they leave of the target's squares. [1]
    """

    found: FloatArray
    doubt: FloatArray
    left: float


def fitted(values: FloatArray, target: FloatArray) -> Fit:
    """Fit terms, values of shape (t, f), to one row's target (t,)."""
    tiny = np.finfo(float).tiny
    with np.errstate(all="ignore"):
        norm = np.sqrt(np.square(values).sum(axis=0))
        if not (np.isfinite(norm).all() and np.isfinite(target).all()):
            return Fit(np.zeros(len(norm)), np.full(len(norm), np.inf), np.inf)
        norm[norm == 0.0] = 1.0
        scaled = values / norm
        left_vectors, sizes, right = np.linalg.svd(scaled, full_matrices=False)
        inverse = right.T / np.maximum(sizes, np.finfo(float).eps * max(float(sizes[0]), 1.0))
        found = inverse @ (left_vectors.T @ target)
        rest = float(np.square(target - scaled @ found).sum())
        deviation = np.sqrt(np.square(inverse).sum(axis=1) * rest / max(len(target) - len(norm), 1))
        doubt = deviation / (np.abs(found) + tiny)
        return Fit(found / norm, doubt, rest / (float(np.square(target).sum()) + tiny))


def unexplained(values: FloatArray, target: FloatArray, chosen: Sequence[int]) -> float:
    """Return what chosen terms of (n, t, f) leave of a target's (n, t) squares, mean over rows. [1]."""
    picked = values[..., list(chosen)]
    return float(np.mean([fitted(one, goal).left for one, goal in zip(picked, target, strict=True)]))


def _without_needless(values: FloatArray, target: FloatArray, chosen: list[int]) -> list[int]:
    limit = max(NEEDLESS, 10.0 * unexplained(values, target, chosen))
    while len(chosen) > 1:
        without = [chosen[:rank] + chosen[rank + 1 :] for rank in range(len(chosen))]
        left = [unexplained(values, target, others) for others in without]
        least = int(np.argmin(left))
        if left[least] > limit:
            break
        chosen = without[least]
    return chosen
