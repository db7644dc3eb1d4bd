"""Exponentials of linear equations are those of SciPy."""

import numpy as np
import pytest
from scipy.linalg import expm

from studies.calibration.state_equations.flow_steps import exponentials


@pytest.mark.parametrize("n_states", [1, 4, 12])
@pytest.mark.parametrize("size", [0.0, 1e-3, 1.0, 1e3])
def test_they_are_those_of_the_states_with_inputs_that_do_not_move(n_states: int, size: float) -> None:
    rng, n_inputs = np.random.default_rng(n_states), 3
    equations = size * rng.standard_normal((5, n_states, n_states + n_inputs))
    # As heat flows: what leaves a state cools it.
    inside = np.abs(equations[..., :n_states]).sum(axis=-1)
    equations[:, np.arange(n_states), np.arange(n_states)] = -inside
    whole = np.zeros((5, n_states + n_inputs, n_states + n_inputs))
    whole[:, :n_states] = equations
    expected = expm(whole)[:, :n_states]
    # Rounding grows with the number of doublings, here and there.
    error = np.abs(exponentials(equations) - expected).max()
    assert error <= 1e-12 * max(size, 1.0) * np.abs(expected).max()


def test_what_overflows_ends_and_leaves_others_alone() -> None:
    equations = np.full((2, 2, 3), 1.7e308)
    equations[1] = [[-1.0, 0.0, 1.0], [1.0, -1.0, 0.0]]
    overflown, good = exponentials(equations)
    assert not np.isfinite(overflown).all()
    np.testing.assert_array_equal(good, exponentials(equations[1:])[0])
