"""A coefficient of a state equation as a function of the parameters, learnt from few simulations.

Coefficients of physical models are quotients and products of few parameters, such as 1 / (R C), or sums of
a few such (product_forms.py), now and then a broken power or a polynomial: where few features explain a
coefficient or its logarithm exactly they are what it is. Of all others nothing is known beyond the rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.parameters import ParameterSpace
from studies.calibration.processes.process import Features
from studies.calibration.state_equations.product_forms import SPARE_ROWS, Products, ProductSum, product_sum
from studies.calibration.state_equations.terms import TINY

# Sum of squares, as a share of all, below which features explain a coefficient exactly.
EXACT_FEATURES = 1e-10
# Features of a sum: with more, few rows would leave none to judge by.
MOST_FEATURES = 4
# Of sets of features so many are looked at further; squares of a column below which others make it up.
N_BEST_SETS, SAME_FEATURE = 12, 1e-9
# Relative to the mean's square: below, a coefficient is a constant.
CONSTANT_SQUARES = 1e-20
# Rows below which nothing is looked for.
# With one or two amounts to find, four rows leave three
# or two numbers that must fit to five digits (same note).
LEAST_TO_LEARN = 4


@dataclass(frozen=True, eq=False)
class Points:
    """Points of a box, as coefficients see them.

    Attributes:
        x: Their features. Shape (n, f). [1]
        theta: Their parameters. Shape (n, p). [per parameter]
    """

    x: FloatArray
    theta: FloatArray

    @classmethod
    def of(cls, space: ParameterSpace, u: FloatArray) -> Self:
        """Return points of the unit cube (n, p)."""
        return cls(Features.of(space).at(u), space.from_unit(u))

    def part(self, rows: slice | IntArray | BoolArray) -> Self:
        """Return some of the points."""
        return replace(self, x=self.x[rows], theta=self.theta[rows])


@dataclass(frozen=True, eq=False)
class Coefficient:
    """A coefficient over the box; make it with `fit`.

    Attributes:
        sign: 1 or -1 of a coefficient that is an exponential, 0 of one that is not.
        mean: Of the values or their logarithms; where there are slopes, the value in the origin.
        slopes: By feature and by its square, where few explain it exactly. Shape (2 f,).
        formula: What it is, where that is a sum of few products.
    """

    sign: float
    mean: float
    slopes: FloatArray | None = None
    formula: ProductSum | None = None

    # What overflows is no formula.
    @classmethod
    @np.errstate(all="ignore")
    def fit(cls, points: Points, values: FloatArray, products: Products) -> Self | None:
        """Learn it; return None where it is no formula, or too few rows show it.

        Args:
            points: The rows.
            values: The coefficient there, NaN in rows that leave it open. Shape (n,).
            products: Of the box's parameters.
        """
        is_known = np.isfinite(values)
        points, values = points.part(is_known), values[is_known]
        x = points.x
        # Where rows leave it open, a formula from fewer than these may be chance.
        if len(values) < LEAST_TO_LEARN:
            return None
        is_signed = bool((values > 0.0).all() or (values < 0.0).all())
        sign = float(np.sign(values[0])) if is_signed else 0.0
        # Logarithms turn products and quotients into sums, which few features explain.
        z = np.log(np.abs(values)) if is_signed else values
        mean = float(z.mean())
        size = float(np.square(z - mean).sum())
        # Differences of logarithms are relative already: they
        # are compared with 1 where their mean is near zero.
        if size <= CONSTANT_SQUARES * len(z) * max(mean**2, float(is_signed)):
            return cls(sign, mean)
        if (found := product_sum(products, points.theta, values)) is not None:
            return cls(0.0, 0.0, formula=found)
        # A coefficient that has one sign may still be a polynomial,
        # so its values are tried beside their logarithms.
        sums = [(_feature_sum(x, z), sign), *([(_feature_sum(x, values), 0.0)] if is_signed else [])]
        (numbers, left), kind = min(sums, key=lambda one: one[0][1])
        return cls(kind, numbers[0], slopes=numbers[1:]) if left < EXACT_FEATURES else None

    @property
    def fixed_value(self) -> float | None:
        """What it is all over the box, None where it depends on a parameter."""
        if self.formula is not None or self.slopes is not None:
            return None
        return self.sign * float(np.exp(self.mean)) if self.sign else self.mean

    def at(self, points: Points) -> FloatArray:
        """Return it at points. Shape (n,)."""
        if self.formula is not None:
            return self.formula.at(points.theta)
        z = np.full(len(points.x), self.mean)
        if self.slopes is not None:
            z += _with_squares(points.x) @ self.slopes
        # Far from the rows an exponential may overflow: what is
        # solved with it is not finite, and counts as failed.
        with np.errstate(over="ignore"):
            return self.sign * np.exp(z) if self.sign else z


def formulas(points: Points, table: FloatArray, products: Products) -> tuple[Coefficient, ...] | None:
    """Learn the coefficients that are the columns of a table (n, c); None where one is no formula."""
    known = list[Coefficient]()
    for column in table.T:
        # After the first that is none, the others need not be looked for.
        if (found := Coefficient.fit(points, column, products)) is None:
            return None
        known.append(found)
    return tuple(known)


def values(table: Sequence[Coefficient], points: Points) -> FloatArray:
    """Return c coefficients at n points. Shape (n, c)."""
    if not table:
        return np.empty((len(points.x), 0))
    return np.stack([one.at(points) for one in table], axis=-1)


def _with_squares(x: FloatArray) -> FloatArray:
    return np.concatenate([x, x**2], axis=1)


def _feature_sum(x: FloatArray, z: FloatArray) -> tuple[FloatArray, float]:
    """Explain values by few features, the best of those that are found with the best of fewer.

    Returns:
        Intercept and slopes, shape (1 + 2 f,), and the share of their squares that is left. [1]
    """
    columns = _with_squares(x)
    centred, left_at_first = columns - columns.mean(axis=0), z - z.mean()
    size, norms = float(np.square(left_at_first).sum()), np.square(centred).sum(axis=0)
    # Sets are searched side by side: one feature after the other did not find
    # GFan / C among 20 with eight rows (docs/notes/state-equations.md, First form).
    best: list[tuple[float, tuple[int, ...]]] = [(1.0, ())]
    # The intercept takes a row, and spare rows separate a formula from chance.
    for _ in range(min(MOST_FEATURES, len(z) - 1 - SPARE_ROWS)):
        shares = dict[tuple[int, ...], float]()
        for _, chosen in best:
            # Beside an orthonormal basis of the chosen ones, what
            # any other feature gains needs no fit of its own.
            basis = np.linalg.qr(centred[:, list(chosen)])[0]
            rest = centred - basis @ (basis.T @ centred)
            left = left_at_first - basis @ (basis.T @ left_at_first)
            squares = np.square(rest).sum(axis=0)
            # What chosen ones make up has rounding left alone, whose direction means nothing.
            gains = np.where(squares > SAME_FEATURE * norms, (left @ rest) ** 2, 0.0) / (squares + TINY)
            for one in np.argsort(gains, kind="stable")[-N_BEST_SETS:].tolist():
                share = (float(left @ left) - float(gains[one])) / size
                shares[tuple(sorted({*chosen, one}))] = share
        best = sorted((share, features) for features, share in shares.items())[:N_BEST_SETS]
        if best[0][0] < EXACT_FEATURES:
            break
    features = list(best[0][1])
    # Projections have found the set; one plain fit gives its numbers without their accumulated rounding.
    picked = np.column_stack([np.ones(len(z)), columns[:, features]])
    numbers = np.linalg.lstsq(picked, z, rcond=None)[0]
    found = np.zeros(1 + columns.shape[1])
    found[[0, *(1 + feature for feature in features)]] = numbers
    return found, float(np.square(z - picked @ numbers).sum()) / size
