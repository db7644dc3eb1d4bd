"""Laws of few products: a coefficient as one product of parameters or their reciprocals, or a sum of such.

Coefficients of physical models are mostly such: 1 / (R C), (U - V) / C, 1 / (R + S), (A U + B V + W) / C. All
powers are 1 or -1, so that no more than the amounts are to be found, and two or three simulations more than
amounts tell which of thousands of products are meant: what is written into a model fits to rounding, all
others by chance to a few per cent.
"""

from dataclasses import dataclass
from itertools import combinations, product
from math import comb
from typing import Self

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.parameters import ParameterSpace

# Weighted squares, as a share of those around the mean, below which a law is exact. Sums of two are so many
# that with few rows some would fit the errors of a coefficient that is one product: there, the second counts.
EXACT, EXACT_OF_FEW, FEW_ROWS = 1e-8, 1e-10, 5
# Rows more than amounts, before chance can be told from a law.
SPARE_ROWS = 2
# The same of longer sums, of which there are more: they have to be what is written into a model.
EXACT_OF_LONG, SPARE_ROWS_OF_LONG = 1e-14, 3
# Products of so many parameters are looked at, and in sums, as far as they are few.
MOST_FACTORS, MOST_PRODUCTS, MOST_PAIRED = 4, 20_000, 1_000
# All sums of two are looked at; of longer ones those that begin with the best shorter ones, so many. So many
# are looked at closely. Squared sines below which a product is made up by others.
MOST_SUMMED, N_BEGINNINGS, N_BEST, SAME_PRODUCT = 3, 200, 8, 1e-10
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
            more = []
            for chosen in combinations(range(space.n_parameters), n_factors):
                for signs in product(*[(1, -1) if kept[one] else (1,) for one in chosen]):
                    row = np.zeros(space.n_parameters, dtype=np.int64)
                    row[list(chosen)] = signs
                    more.append(row)
            powers += more
            if len(powers) <= MOST_PAIRED:
                n_paired = len(powers)
        return cls(np.array(powers), n_paired)

    def at(self, theta: FloatArray) -> FloatArray:
        """Return the products at parameters (n, p). Shape (n, m)."""
        return values_of(self.powers, theta)


def values_of(powers: IntArray, theta: FloatArray) -> FloatArray:
    """Return products with powers (m, p) at parameters (n, p). Shape (n, m)."""
    values = np.ones((len(theta), len(powers)))
    for j, column in enumerate(theta.T):
        values[:, powers[:, j] > 0] *= column[:, None]
        values[:, powers[:, j] < 0] /= column[:, None]
    return values


@dataclass(frozen=True, eq=False)
class ProductLaw:
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
        values = values_of(self.powers, theta) @ self.amounts
        return 1.0 / values if self.is_reciprocal else values


def product_law(products: Products, theta: FloatArray, values: FloatArray) -> ProductLaw | None:
    """Explain values exactly by one product, or by the sum of two or its reciprocal.

    Args:
        products: Those of the box.
        theta: The rows' parameters. Shape (n, p). [per parameter]
        values: The coefficient there. Shape (n,).

    Returns:
        The law, None where none of these is exact.
    """
    if len(values) < 1 + SPARE_ROWS:
        return None
    table = products.at(theta)
    weight = _weight(values)
    single, left = _single(table * weight[:, None], values * weight, weight)
    if left < EXACT:
        return _fitted(products.powers[[single]], theta, values, weight)
    goals = [values, *([1.0 / values] if (values > 0.0).all() or (values < 0.0).all() else [])]
    beginnings: list[IntArray | None] = [None] * len(goals)
    for n_summed in range(2, min(MOST_SUMMED, products.n_paired) + 1):
        if len(values) < n_summed + (SPARE_ROWS if n_summed == 2 else SPARE_ROWS_OF_LONG):
            break
        found, laws = list[float](), list[ProductLaw]()
        for kind, goal in enumerate(goals):
            weight = _weight(goal)
            scaled = table[:, : products.n_paired] * weight[:, None]
            sums = _longer(scaled, goal * weight, beginnings[kind])
            beginnings[kind] = sums
            for chosen in sums[:N_BEST]:
                law = _fitted(products.powers[chosen], theta, goal, weight)
                found.append(_left((law.at(theta) - goal) * weight, goal * weight, weight))
                laws.append(ProductLaw(law.amounts, law.powers, bool(kind)))
        exact = EXACT_OF_FEW if len(values) <= FEW_ROWS else EXACT
        if found and min(found) < (exact if n_summed == 2 else EXACT_OF_LONG):
            return laws[int(np.argmin(found))]
    return None


def _weight(values: FloatArray) -> FloatArray:
    return 1.0 / np.sqrt(values**2 + NEXT_TO_NOTHING**2 * np.mean(values**2))


def _left(error: FloatArray, values: FloatArray, weight: FloatArray) -> float:
    """Return squared errors as a share of what a constant leaves, all weighted. [1]."""
    around = values - weight * (weight @ values) / (weight @ weight)
    return float(error @ error) / max(float(around @ around), float(np.finfo(float).tiny))


def _single(table: FloatArray, values: FloatArray, weight: FloatArray) -> tuple[int, float]:
    """Return which product (n, m) explains values alone the best, and what it leaves. [1]."""
    amounts = (values @ table) / np.maximum(np.square(table).sum(axis=0), np.finfo(float).tiny)
    errors = np.square(values[:, None] - table * amounts).sum(axis=0)
    best = int(np.argmin(errors))
    return best, _left(values - table[:, best] * amounts[best], values, weight)


def _longer(table: FloatArray, values: FloatArray, beginnings: IntArray | None) -> IntArray:
    """Return the sums, one product longer than their beginnings, that explain values the best.

    Args:
        table: Weighted products. Shape (n, m).
        values: Weighted values. Shape (n,).
        beginnings: Which products they begin with, None for any single one. Shape (b, k).

    Returns:
        Which products they are of, the best first. Shape (at most N_BEGINNINGS, k + 1).
    """
    norms = np.sqrt(np.square(table).sum(axis=0))
    table = table / np.where(norms > 0.0, norms, 1.0)
    m = table.shape[1]
    if beginnings is None:
        beginnings = np.arange(m)[:, None]
    explained = np.empty((len(beginnings), m))
    for row, chosen in enumerate(beginnings):
        basis = np.linalg.qr(table[:, chosen])[0]
        rest = table - basis @ (basis.T @ table)
        left = values - basis @ (basis.T @ values)
        squares = np.square(rest).sum(axis=0)
        gain = np.where(
            squares > SAME_PRODUCT, (left @ rest) ** 2 / np.maximum(squares, SAME_PRODUCT), -np.inf
        )
        explained[row] = float(values @ values) - float(left @ left) + gain
    order = np.argsort(-explained, axis=None, kind="stable")[: 2 * len(explained[0]) + 4 * N_BEGINNINGS]
    sums = np.column_stack([beginnings[order // m], order % m])[np.isfinite(explained.reshape(-1)[order])]
    # Whatever they began with, sums of the same products are one.
    _, first = np.unique(np.sort(sums, axis=1), axis=0, return_index=True)
    kept: IntArray = sums[np.sort(first)][:N_BEGINNINGS]
    return kept


def _fitted(powers: IntArray, theta: FloatArray, values: FloatArray, weight: FloatArray) -> ProductLaw:
    columns = values_of(powers, theta) * weight[:, None]
    norms = np.sqrt(np.square(columns).sum(axis=0))
    amounts = np.linalg.lstsq(columns / norms, values * weight, rcond=None)[0] / norms
    return ProductLaw(amounts, powers)
