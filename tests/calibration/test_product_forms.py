"""Formulas of few products, found from as few rows as can identify them."""

from collections.abc import Callable

import numpy as np
import pytest

from simulation.arrays import FloatArray
from simulation.parameters import Parameter, ParameterSpace
from studies.calibration.search.first_design import latin_hypercube
from studies.calibration.state_equations.coefficient import Coefficient, Points
from studies.calibration.state_equations.product_forms import (
    MOST_PAIRED,
    MOST_PRODUCTS,
    Products,
    product_sum,
)

NAMES = ("R", "S", "C", "U", "T", *(f"other{i}" for i in range(9)))
SPACE = ParameterSpace(
    (
        *(Parameter(name, 0.2, 5.0, scale="log") for name in NAMES[:4]),
        Parameter("T", -10.0, 20.0),
        *(Parameter(name, 1e3, 1e5, scale="log") for name in NAMES[5:]),
    )
)
PRODUCTS = Products.of(SPACE)


def rows(seed: int, n: int) -> FloatArray:
    design = 0.15 + 0.7 * latin_hypercube(14, 14, np.random.default_rng(seed))
    return SPACE.from_unit(design)[:n]


def column(theta: FloatArray, name: str) -> FloatArray:
    return theta[:, NAMES.index(name)]


FORMULAS: dict[str, Callable[[FloatArray], FloatArray]] = {
    "quotient": lambda t: -2.0 / (column(t, "R") * column(t, "C")),
    "three": lambda t: 1e-3 * column(t, "R") * column(t, "U") / column(t, "C"),
    "difference": lambda t: (3.0 / column(t, "R") - 0.2 * column(t, "U")) / column(t, "C"),
    "in series": lambda t: 1.0 / (3.0 * column(t, "R") + 0.2 * column(t, "S")),
    "offset": lambda t: column(t, "T") + 273.15,
}


LONG: dict[str, Callable[[FloatArray], FloatArray]] = {
    "house": lambda t: (
        (80.0 * column(t, "R") + 20.0 * column(t, "S") + 9.0 * column(t, "U")) / column(t, "C")
    ),
    "in series": lambda t: 1.0 / (2.0 * column(t, "R") + 0.2 * column(t, "S") + 0.9 * column(t, "U")),
}


@pytest.mark.parametrize("decades", [8, 60, 300])
def test_products_that_overflow_are_no_candidates_and_those_that_do_not_are_still_found(decades: int) -> None:
    space = ParameterSpace(
        tuple(
            Parameter(name, 10.0 ** (-decades / 2), 10.0 ** (decades / 2), scale="log")
            for name in ("R", "S", "C", "U")
        )
    )
    products = Products.of(space)
    for seed in range(5):
        u = latin_hypercube(8, 4, np.random.default_rng(seed))
        theta = space.from_unit(u)
        r, s, c, _ = theta.T
        with np.errstate(all="ignore"):
            wild = (np.exp(r), r * s * c, 1.0 / (r + s))
        for values in wild:
            known = np.where(np.isfinite(values), values, 1e300)
            product_sum(products, theta, known)
            Coefficient.fit(Points.of(space, u), values, products)
        found = product_sum(products, theta, 2.0 / r)
        assert found is not None
        np.testing.assert_allclose(found.at(theta), 2.0 / r, rtol=1e-6)


@pytest.mark.parametrize(("name", "n"), [*((name, 4) for name in FORMULAS), *((name, 6) for name in LONG)])
def test_a_product_form_is_found_from_two_or_three_rows_more_than_amounts_and_holds_everywhere(
    name: str, n: int
) -> None:
    formula = (FORMULAS if n == 4 else LONG)[name]
    fresh = SPACE.from_unit(np.random.default_rng(1).random((50, 14)))
    for seed in range(10):
        theta = rows(seed, n)
        found = product_sum(PRODUCTS, theta, formula(theta))
        assert found is not None
        np.testing.assert_allclose(found.at(fresh), formula(fresh), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("n", [4, 7])
def test_what_is_no_product_is_taken_for_none(n: int) -> None:
    for seed in range(10):
        theta, rng = rows(seed, n), np.random.default_rng(seed)
        assert product_sum(PRODUCTS, theta, rng.lognormal(size=n)) is None
        bent = np.exp(np.sin(3.0 * np.log(column(theta, "R")))) / column(theta, "C")
        assert product_sum(PRODUCTS, theta, bent) is None
        nearly = FORMULAS["quotient"](theta) * (1.0 + 1e-3 * rng.standard_normal(n))
        # Of four rows a sum can take one for a little something: a fifth row there removes it.
        assert n == 4 or product_sum(PRODUCTS, theta, nearly) is None


def test_fewer_rows_show_nothing() -> None:
    assert product_sum(PRODUCTS, rows(0, 2), FORMULAS["quotient"](rows(0, 2))) is None
    assert product_sum(PRODUCTS, rows(0, 3), FORMULAS["difference"](rows(0, 3))) is None
    assert product_sum(PRODUCTS, rows(0, 3), FORMULAS["quotient"](rows(0, 3))) is not None


def test_products_stay_few_and_only_what_keeps_its_sign_has_a_reciprocal() -> None:
    t = NAMES.index("T")
    assert set(PRODUCTS.powers[:, t]) == {0, 1}
    assert set(PRODUCTS.powers[:, 0]) == {-1, 0, 1}
    assert len(np.unique(PRODUCTS.powers, axis=0)) == len(PRODUCTS.powers)
    for n in (60, 300):
        large = Products.of(ParameterSpace(tuple(Parameter(f"p{i}", 1.0, 2.0) for i in range(n))))
        assert n < len(large.powers) <= MOST_PRODUCTS
        assert large.n_paired <= MOST_PAIRED
