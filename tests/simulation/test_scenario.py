"""Inputs over communication steps: held, linear and smooth, each against an independent calculation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.interpolate import PchipInterpolator

from simulation.scenario import covers, values_over_steps

TIME = np.arange(9) * 1800.0
VALUES = np.array([0.0, 1.0, 1.0, 4.0, 3.0, 3.5, -2.0, 0.0, 1.0])


def _edges(start: float, step: float, n: int) -> np.ndarray:
    return start + step * np.arange(n + 1)


def test_a_held_value_is_the_last_sample_when_the_step_starts():
    edges = _edges(1800, 600, 9)
    held = values_over_steps(TIME, VALUES, edges, interpolation="held")
    assert held.tolist() == [1, 1, 1, 1, 1, 1, 4, 4, 4]


def test_a_smooth_mean_is_the_quadrature_of_pchip():
    edges = _edges(900, 700, 18)
    curve = PchipInterpolator(TIME, VALUES)
    smooth = values_over_steps(TIME, VALUES, edges, interpolation="smooth")
    for value, a, b in zip(smooth, edges[:-1], edges[1:], strict=True):
        inside = TIME[(a < TIME) & (b > TIME)]
        area = quad(curve, a, b, points=inside if len(inside) else None, epsabs=1e-9)[0]
        assert value == pytest.approx(area / (b - a), abs=1e-10)


@settings(deadline=None)
@given(
    st.sampled_from(["linear", "smooth"]),
    st.lists(st.floats(-50, 50).map(lambda value: round(value, 6)), min_size=9, max_size=9),
)
def test_means_keep_the_integral_whatever_the_step(interpolation: str, samples: list[float]):
    values = np.array(samples)
    coarse = values_over_steps(TIME, values, _edges(0, 3600, 4), interpolation=interpolation)
    fine = values_over_steps(TIME, values, _edges(0, 400, 36), interpolation=interpolation)
    np.testing.assert_allclose(fine.reshape(4, 9).mean(axis=1), coarse, atol=1e-9)
    assert fine.min() >= values.min() - 1e-9
    assert fine.max() <= values.max() + 1e-9


def test_nothing_is_extended_silently():
    assert covers(TIME, _edges(0, 600, 27), "held")
    assert not covers(TIME, _edges(0, 600, 28), "held")
    assert covers(TIME, _edges(0, 600, 24), "smooth")
    assert not covers(TIME, _edges(0, 600, 25), "smooth")
    assert not covers(TIME, _edges(-600, 600, 5), "held")
    for interpolation in ("held", "linear", "smooth"):
        with pytest.raises(ValueError, match="does not cover"):
            values_over_steps(TIME, VALUES, _edges(0, 600, 30), interpolation=interpolation)
