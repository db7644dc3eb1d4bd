"""The box and the unit cube."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulation import InputError, Parameter, ParameterSpace

SPACE = ParameterSpace(
    (
        Parameter("R", 0.036, 0.9, 0.18, "m2.K/W", "log"),
        Parameter("T", 293.15, 306.15, 301.15, "K"),
        Parameter("offset", -5.0, 5.0, None, "K"),
    )
)
units = st.lists(st.tuples(*[st.floats(0, 1)] * 3), min_size=1, max_size=5).map(np.array)


@given(units)
def test_the_round_trip_through_the_box_returns(u: np.ndarray):
    theta = SPACE.from_unit(u)
    assert SPACE.contains(theta).all()
    # Rounding in logarithm and exponential; coordinates are of order one.
    np.testing.assert_allclose(SPACE.to_unit(theta), u, atol=1e-12)


def test_the_bounds_are_hit_exactly():
    assert np.array_equal(SPACE.from_unit(np.zeros(3)), SPACE.lower)
    assert np.array_equal(SPACE.from_unit(np.ones(3)), SPACE.upper)
    assert np.array_equal(SPACE.to_unit(np.array([SPACE.lower, SPACE.upper])), [[0, 0, 0], [1, 1, 1]])


def test_what_is_no_number_stays_none_and_lies_outside():
    theta = SPACE.from_unit(np.array([np.nan, 0.5, 0.5]))
    assert np.isnan(theta[0])
    assert not SPACE.contains(theta)
    assert np.isnan(SPACE.to_unit(np.array([-1.0, 300.0, 0.0]))[0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("k", 2.0, 1.0), "lower = 2 is not below"),
        (("k", np.nan, 1.0), "not finite"),
        (("k", 0.0, 1.0, 2.0), "estimate = 2 lies outside the bounds 0 to 1"),
        (("k", 0.0, 1.0, None, "1", "log"), "needs positive bounds, lower is 0"),
        (("k", 0.1, 1.0, None, "1", "cubic"), 'scale = "cubic" is unknown'),
    ],
)
def test_a_contradictory_parameter_is_refused(arguments: tuple, message: str):
    with pytest.raises(InputError, match=message):
        Parameter(*arguments)


def test_a_space_needs_parameters_of_different_names():
    with pytest.raises(InputError, match="at least one"):
        ParameterSpace(())
    with pytest.raises(InputError, match="k is declared 2 times"):
        ParameterSpace((Parameter("k", 0, 1), Parameter("k", 0, 2)))
