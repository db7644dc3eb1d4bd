"""Designs: inside the box, uniform in physical units, nested."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from simulation import Parameter, ParameterSpace, uniform_design
from simulation.design import spread_design

SPACE = ParameterSpace(
    (Parameter("R", 0.2, 5.0, scale="log"), Parameter("C", 0.2e4, 5e4, scale="log"), Parameter("T", 290, 300))
)


@given(st.integers(0, 60), st.integers(0, 60), st.integers(0, 2**32))
def test_a_smaller_design_is_the_beginning_of_a_larger_one(n: int, more: int, seed: int):
    assert np.array_equal(uniform_design(SPACE, n + more, seed)[:n], uniform_design(SPACE, n, seed))
    assert np.array_equal(spread_design(SPACE, n + more, 0.3, seed)[:n], spread_design(SPACE, n, 0.3, seed))


@given(st.floats(0, 1), st.integers(0, 2**32))
def test_a_spread_design_keeps_its_distance_from_the_middle(spread: float, seed: int):
    rows = spread_design(SPACE, 20, spread, seed, columns=("C", "T"))
    assert SPACE.contains(rows).all()
    distance = np.abs(rows - (SPACE.lower + SPACE.upper) / 2) / ((SPACE.upper - SPACE.lower) / 2)
    assert (distance[:, 1:] <= spread + 1e-12).all()


def test_the_draw_is_uniform_in_physical_units_also_where_the_scale_is_logarithmic():
    # Kolmogorov-Smirnov distance; 1.63 / sqrt(n) is the 1 % point.
    n = 4000
    rows = np.sort((uniform_design(SPACE, n, 0) - SPACE.lower) / (SPACE.upper - SPACE.lower), axis=0)
    assert np.abs(rows - (np.arange(n)[:, None] + 0.5) / n).max() < 1.63 / np.sqrt(n)
