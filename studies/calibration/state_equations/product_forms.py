"""Formulas of few products: a coefficient as one product of parameters or reciprocals, or a sum of such.

Coefficients of physical models are mostly such: 1 / (R C), (U - V) / C, 1 / (R + S), (A U + B V + W) / C. All
powers are 1 or -1, so that only the amounts are to be found. Two or three simulations more than amounts
decide between thousands of products: those that are written into a model fit to rounding, all others by
chance to a few per cent.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from math import comb
from typing import Self

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.parameters import ParameterSpace
from studies.calibration.state_equations.term_choice import explained_by_pairs
from studies.calibration.state_equations.terms import TINY, spread

# Weighted squares, as a share of those around the mean, below which a formula is exact. Sums of two are so
# many that with few rows some would fit the errors of one product: there, the second counts.
# Errors of 1e-4 and 1e-5, squared: coefficients of the office are good
# to 1e-5 and worse (docs/notes/state-equations.md, Whole powers).
EXACT_PRODUCTS, EXACT_OF_FEW, FEW_ROWS = 1e-8, 1e-10, 5
# Rows more than amounts or other numbers, before chance can be separated from a formula.
SPARE_ROWS = 2
# The same of longer sums, of which there are more: they have to be what is written into a model.
EXACT_OF_LONG, SPARE_ROWS_OF_LONG = 1e-14, 3
# Products of so many parameters are looked at, and in sums, as far as they are few.
# Of 14 parameters there are 19,321 products of at most four (3,305 of at most three), and of the 393
# products of at most two there are 77,028 sums of two.
MOST_FACTORS, MOST_PRODUCTS, MOST_PAIRED = 4, 20_000, 1_000
# So many rows decide which products may be meant.
# So a coefficient without formula takes 14 to 45 ms, with up to 200 rows and 22 parameters (the same note).
MOST_PROPOSING = 12
# All sums of two are looked at; of longer ones those that begin with the best shorter ones, so many. So many
# are looked at closely. Squared sines below which a product is made up by others.
# All of 20 drawn sums of three were found so, from six
# rows; of sums of four 2 of 5, from ten (the same note).
MOST_SUMMED, N_BEGINNINGS, N_BEST_SUMS, SAME_PRODUCT = 3, 200, 8, 1e-10
# Values count by themselves, but not those that happen to be next to nothing. [root mean square]
NEXT_TO_NOTHING = 1e-3


@dataclass(frozen=True, eq=False)
class Products:
    """The products of a box's parameters; make it with `of`.

    Attributes:
        powers: Powers of the parameters, -1, 0 or 1, the constant and short products first. Shape (m, p).
        n_paired: How many of the first are summed, too.
    """

    powers: IntArray
    n_paired: int

    @classmethod
    def of(cls, space: ParameterSpace) -> Self:
        """Return the products of a box's parameters; only what keeps its sign has a reciprocal."""
        kept = (space.lower > 0.0) | (space.upper < 0.0)
        powers, n_paired = [np.zeros(space.n_parameters, dtype=np.int64)], 1
        for n_factors in range(1, MOST_FACTORS + 1):
            if len(powers) + comb(space.n_parameters, n_factors) * 2**n_factors > MOST_PRODUCTS:
                break
            for chosen in combinations(range(space.n_parameters), n_factors):
                for signs in product(*[(1, -1) if kept[one] else (1,) for one in chosen]):
                    row = np.zeros(space.n_parameters, dtype=np.int64)
                    row[list(chosen)] = signs
                    powers.append(row)
            if len(powers) <= MOST_PAIRED:
                n_paired = len(powers)
        return cls(np.array(powers), n_paired)


def values_of(powers: IntArray, theta: FloatArray) -> FloatArray:
    """Return products with powers (m, p) at parameters (n, p). Shape (n, m)."""
    # Powers of 1 and -1 need no logarithms, which negative parameters would not have.
    values = np.ones((len(theta), len(powers)))
    for j in np.flatnonzero(powers.any(axis=0)):
        values[:, powers[:, j] > 0] *= theta[:, j, None]
        values[:, powers[:, j] < 0] /= theta[:, j, None]
    return values


@dataclass(frozen=True, eq=False)
class ProductSum:
    """A sum of products, or its reciprocal.

    Attributes:
        amounts: What each product is multiplied with. Shape (k,).
        powers: Their powers. Shape (k, p).
        is_reciprocal: Whether the coefficient is one over the sum.
    """

    amounts: FloatArray
    powers: IntArray
    is_reciprocal: bool = False

    def at(self, theta: FloatArray) -> FloatArray:
        """Return the coefficient at parameters (n, p). Shape (n,)."""
        products = np.ones((len(self.amounts), len(theta)))
        for place, j, power in self._factors:
            if power > 0:
                products[place] *= theta[:, j]
            else:
                products[place] /= theta[:, j]
        values = products.T @ self.amounts
        return 1.0 / values if self.is_reciprocal else values

    @cached_property
    def _factors(self) -> list[tuple[int, int, int]]:
        """Product, parameter and power of every factor."""
        return [(place, j, self.powers[place, j]) for place, j in np.argwhere(self.powers).tolist()]


def shortest_product(products: Products, theta: FloatArray, value: float, amount: float) -> ProductSum | None:
    """Return the shortest product, an amount or its opposite times parameters, that has a value at one point.

    Args:
        products: The products of the parameters.
        theta: The point's parameters. Shape (p,). [per parameter]
        value: The value that the product has to have.
        amount: The factor of the product.

    Returns:
        The formula, None where no product is as exact as coefficients are.
    """
    powers = products.powers[: products.n_paired]
    # A parameter may be zero there.
    with np.errstate(all="ignore"):
        shares = value / (amount * values_of(powers, theta[None])[0])
    found = np.flatnonzero((np.abs(shares) - 1.0) ** 2 < EXACT_PRODUCTS)
    if not found.size:
        return None
    return ProductSum(amount * np.sign(shares[found[:1]]), powers[found[:1]])


# In boxes of many decades products overflow: what is not finite is no candidate.
@np.errstate(all="ignore")
def product_sum(products: Products, theta: FloatArray, values: FloatArray) -> ProductSum | None:
    """Explain values exactly by one product, or by the sum of two or three or its reciprocal.

    Args:
        products: The products of the parameters.
        theta: The rows' parameters. Shape (n, p). [per parameter]
        values: The coefficient there. Shape (n,).

    Returns:
        The formula, None where none of these is exact.
    """
    if len(values) < 1 + SPARE_ROWS:
        return None
    # A part of the rows proposes products, all rows judge them.
    some = spread(len(values), MOST_PROPOSING)
    table = values_of(products.powers, theta[some])
    # A column of zeros explains nothing.
    table = np.where(np.isfinite(table).all(axis=0), table, 0.0)
    # One product goes first: in a sum, a second one would only absorb its error (the same note).
    left, formula = _judged(products.powers[[_single(table, values[some])]], theta, values)
    if left < EXACT_PRODUCTS:
        return formula
    # Resistances in series make a coefficient one over a sum, such as 1 / (R + S).
    goals = [values, *([1.0 / values] if (values > 0.0).all() or (values < 0.0).all() else [])]
    table = table[:, : products.n_paired]
    beginnings = dict[int, IntArray]()
    for n_summed in range(2, min(MOST_SUMMED, products.n_paired) + 1):
        if len(values) < n_summed + (SPARE_ROWS if n_summed == 2 else SPARE_ROWS_OF_LONG):
            break
        judged = []
        for kind, goal in enumerate(goals):
            weight = _weight(goal[some])
            scaled, sought = table * weight[:, None], goal[some] * weight
            scaled = scaled / np.maximum(np.sqrt(np.square(scaled).sum(axis=0)), TINY)
            explained = _pairs(scaled, sought) if n_summed == 2 else _longer(scaled, sought, beginnings[kind])
            beginnings[kind] = _best_sums(explained, beginnings.get(kind))
            judged += [
                _judged(products.powers[chosen], theta, goal, is_reciprocal=bool(kind))
                for chosen in beginnings[kind][:N_BEST_SUMS]
            ]
        if not judged:
            break
        exact = EXACT_OF_FEW if len(values) <= FEW_ROWS else EXACT_PRODUCTS
        left, formula = min(judged, key=lambda one: one[0])
        if left < (exact if n_summed == 2 else EXACT_OF_LONG):
            return formula
    return None


def _judged(
    powers: IntArray, theta: FloatArray, values: FloatArray, *, is_reciprocal: bool = False
) -> tuple[float, ProductSum]:
    """Fit amounts of products to values; return what they leave, and the formula.

    They leave squared errors, as a share of what a constant leaves, all weighted.
    """
    weight = _weight(values)
    columns, goal = values_of(powers, theta) * weight[:, None], values * weight
    norms = np.sqrt(np.square(columns).sum(axis=0))
    # Products of different units differ by decades; columns of length 1 make the fit well conditioned.
    scaled = columns / norms
    if not (np.isfinite(scaled).all() and np.isfinite(goal).all()):
        return np.inf, ProductSum(np.zeros(len(powers)), powers, is_reciprocal)
    amounts = np.linalg.lstsq(scaled, goal, rcond=None)[0] / norms
    error = columns @ amounts - goal
    # Weighted, a constant is the weight itself: its projection is what a constant explains.
    around = goal - weight * (weight @ goal) / (weight @ weight)
    left = float(error @ error) / max(float(around @ around), TINY)
    return left if np.isfinite(left) else np.inf, ProductSum(amounts, powers, is_reciprocal)


def _weight(values: FloatArray) -> FloatArray:
    # Errors count relative to each row, as coefficients vary a hundredfold over a box (the same note).
    return np.asarray(1.0 / np.sqrt(values**2 + NEXT_TO_NOTHING**2 * np.mean(values**2)))


def _single(table: FloatArray, values: FloatArray) -> int:
    """Return which product (n, m) explains values alone the best."""
    weight = _weight(values)
    table, values = table * weight[:, None], values * weight
    amounts = (values @ table) / np.maximum(np.square(table).sum(axis=0), TINY)
    left = np.square(values[:, None] - table * amounts).sum(axis=0)
    return int(np.argmin(np.where(np.isfinite(left), left, np.inf)))


def _pairs(table: FloatArray, values: FloatArray) -> FloatArray:
    """Return what all pairs of columns (n, m) of length 1 explain of values (n,). Shape (m, m)."""
    explained = explained_by_pairs(table, values @ table, alike=-np.inf)
    # Each pair once, and no column with itself.
    return np.where(np.tri(len(explained), dtype=np.bool_), -np.inf, explained)


def _longer(table: FloatArray, values: FloatArray, beginnings: IntArray) -> FloatArray:
    """Return what sums that begin so (b, k) explain with one more column (n, m) of values. Shape (b, m)."""
    # Beside an orthonormal basis of a beginning, what one
    # more column explains is one projection: no fit per sum.
    basis = np.linalg.qr(table[:, beginnings].transpose(1, 0, 2))[0]
    rest = table - basis @ (basis.transpose(0, 2, 1) @ table)
    along = basis.transpose(0, 2, 1) @ values
    left = values - np.einsum("bnk,bk->bn", basis, along)
    squares = np.square(rest).sum(axis=1)
    gain = np.einsum("bn,bnm->bm", left, rest) ** 2 / np.maximum(squares, SAME_PRODUCT)
    return np.where(squares > SAME_PRODUCT, np.square(along).sum(axis=1)[:, None] + gain, -np.inf)


def _best_sums(explained: FloatArray, beginnings: IntArray | None) -> IntArray:
    """Return which products the sums are of that explain the most, the best first. Shape (at most b, k).

    Args:
        explained: By beginning and by the product that is added. Shape (b, m).
        beginnings: None where these are single products. Shape (b, k - 1).
    """
    m = explained.shape[1]
    if beginnings is None:
        beginnings = np.arange(m)[:, None]
    # A sum of k products may have been begun in k ways.
    n = min(MOST_SUMMED * N_BEGINNINGS, explained.size)
    # Of up to a million pairs only the best are sorted:
    # partitioning takes time in proportion to their number.
    order = np.argpartition(-explained, n - 1, axis=None)[:n]
    order = order[np.argsort(-explained.reshape(-1)[order], kind="stable")]
    order = order[np.isfinite(explained.reshape(-1)[order])]
    sums = np.sort(np.column_stack([beginnings[order // m], order % m]), axis=1)
    # unique sorts sums by the positions of their products;
    # `first` brings back the order by what they explain.
    _, first = np.unique(sums, axis=0, return_index=True)
    return np.asarray(sums[np.sort(first)][:N_BEGINNINGS])
