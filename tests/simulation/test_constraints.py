"""Pairs of parameters that keep their order, whatever samples or moves them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulation.arrays import FloatArray
from simulation.design import spread_design, uniform_design
from simulation.errors import InputError
from simulation.fmi.ties import sum_limit
from simulation.parameters import Parameter, ParameterSpace, SumLimit

SPACE = ParameterSpace(
    (
        Parameter("large", 1.0, 50.0, scale="log"),
        Parameter("small", 0.5, 100.0, scale="log"),
        Parameter("middle", 2.0, 20.0),
        Parameter("free", -1.0, 1.0),
    ),
    (("small", "middle"), ("middle", "large"), ("small", "large")),
)


def keeps_order(theta: FloatArray) -> bool:
    large, small, middle, _ = theta.T
    return bool((small <= middle).all() and (middle <= large).all())


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-0.5, 1.5), min_size=4, max_size=4))
def test_every_point_of_the_cube_keeps_them(point: list[float]) -> None:
    theta = SPACE.from_unit(np.array([point]))

    assert keeps_order(theta)
    assert SPACE.contains(theta).all()


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(0.01, 0.99), min_size=4, max_size=4))
def test_cube_and_parameters_are_mapped_both_ways(point: list[float]) -> None:
    u = np.array([point])

    np.testing.assert_allclose(SPACE.to_unit(SPACE.from_unit(u)), u, rtol=0.0, atol=1e-9)


def test_designs_keep_them_and_are_nested() -> None:
    some, more = uniform_design(SPACE, 16, 3), uniform_design(SPACE, 200, 3)

    assert keeps_order(more)
    np.testing.assert_array_equal(more[:16], some)
    assert keeps_order(spread_design(SPACE, 50, 0.9, 1))


def test_a_design_without_constraints_is_as_before() -> None:
    box = ParameterSpace(SPACE.parameters)
    draw = 2.0 * np.random.default_rng(3).random((8, 4)) - 1.0
    middle, reach = (box.lower + box.upper) / 2, (box.upper - box.lower) / 2

    np.testing.assert_array_equal(
        uniform_design(box, 8, 3), np.clip(middle + reach * draw, box.lower, box.upper)
    )


def test_single_parameters_move_as_far_as_the_others_let_them() -> None:
    lower, upper = SPACE.ends(np.array([10.0, 1.0, 5.0, 0.0]))

    np.testing.assert_array_equal(lower, [5.0, 0.5, 2.0, -1.0])
    np.testing.assert_array_equal(upper, [50.0, 5.0, 10.0, 1.0])


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ((("large", "small"), ("small", "large")), "contradicts others"),
        ((("free", "middle"), ("large", "free")), "no values within the bounds"),
    ],
)
def test_what_nothing_can_keep_is_refused(pairs: tuple[tuple[str, str], ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        ParameterSpace(SPACE.parameters, pairs).from_unit(np.zeros((1, 4)))


SHARES = ParameterSpace(
    (
        Parameter("a", 0.0, 1.0),
        Parameter("b", 0.05, 1.0, scale="log"),
        Parameter("free", -1.0, 1.0),
        Parameter("c", 0.0, 0.6),
    ),
    sums=(SumLimit((("a", 1.0), ("b", 1.0), ("c", 2.0)), 1.2),),
)
DIFFERENCE = ParameterSpace(
    (Parameter("a", 0.0, 4.0), Parameter("b", 0.0, 3.0), Parameter("c", -1.0, 1.0)),
    sums=(SumLimit((("a", -1.0), ("b", 2.0), ("c", -1.0)), -0.5),),
)


@pytest.mark.parametrize("space", [SHARES, DIFFERENCE])
@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-0.2, 1.2), min_size=4, max_size=4))
def test_every_point_of_the_cube_keeps_sums(space: ParameterSpace, point: list[float]) -> None:
    u = np.array([point[: space.n_parameters]])
    theta = space.from_unit(u)
    assert space.contains(theta).all()
    inner = np.clip(u, 0.01, 0.99)
    np.testing.assert_allclose(space.to_unit(space.from_unit(inner)), inner, rtol=0.0, atol=1e-9)
    lower, upper = space.ends(theta[0])
    for k in range(space.n_parameters):
        for end in (lower[k], upper[k]):
            moved = theta[0].copy()
            moved[k] = end
            assert space.contains(moved)


@pytest.mark.parametrize("space", [SHARES, DIFFERENCE])
def test_the_cube_reaches_all_that_keeps_a_sum(space: ParameterSpace) -> None:
    theta = uniform_design(space, 500, 1)
    np.testing.assert_allclose(space.from_unit(space.to_unit(theta)), theta, atol=1e-9)
    u = space.to_unit(theta)
    assert u.min() >= 0.0
    assert u.max() <= 1.0 + 1e-12


def test_a_sum_that_nothing_keeps_is_refused() -> None:
    one = ParameterSpace(SHARES.parameters, sums=(SumLimit((("a", 1.0), ("b", 1.0)), 0.01),))
    with pytest.raises(InputError, match="constraint on a, b: no values within the bounds keep it"):
        one.from_unit(np.zeros((1, 4)))


@pytest.mark.parametrize(
    ("text", "terms", "most"),
    [
        ("fA + fB <= 0.9", {"fA": 1.0, "fB": 1.0}, 0.9),
        ("2 * a - b / 4 > 1", {"a": -2.0, "b": 0.25}, -1.0),
        ("a < b + 3", {"a": 1.0, "b": -1.0}, 3.0),
        ("-(a - 1) >= 2 * (b + c)", {"b": 2.0, "c": 2.0, "a": 1.0}, 1.0),
        ("wall.R[1] + wall.R[2] < 1", {"wall.R[1]": 1.0, "wall.R[2]": 1.0}, 1.0),
    ],
)
def test_sums_are_read(text: str, terms: dict[str, float], most: float) -> None:
    limit = sum_limit(text, "constraints")
    assert (dict(limit.terms), limit.most) == (terms, most)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("fA + fB + fC = 1", 'take it out of .*under .tied., as fC = "1 - fA - fB"'),
        ("a * b < 1", "is no pair and no sum"),
        ("a < 1", "or narrow the bounds of one"),
        ("a < b < c", "is no pair; write"),
        ("__import__('os') < a", "is no pair and no sum"),
        ("a / 0 < b", "is no pair and no sum"),
    ],
)
def test_what_is_no_sum_is_refused(text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        sum_limit(text, "constraints")
