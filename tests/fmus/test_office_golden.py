"""The office FMU against the paper's equations, solved by the matrix exponential."""

import numpy as np
import office_equations as reference
import pytest

# The solution is exact up to rounding: 300 K times a few hundred roundings.
EXACT_K = 1e-9
T_AIR_K = 296.22


def simulate(office, theta, inputs):
    first = dict(zip(reference.INPUTS, inputs[0], strict=True))
    office.initialize(**dict(zip(reference.NAMES, theta, strict=True)), TAirInit=T_AIR_K, **first)
    return np.array(office.run(reference.INPUTS, inputs, reference.STEP_S, "TAir"))


@pytest.mark.parametrize("seed", range(3))
def test_the_matrix_exponential_gives_the_same_air_temperature(office, seed):
    theta = reference.random_theta(1, seed)[0]
    inputs = reference.varied_inputs(432, seed)
    expected = reference.solve_exactly(theta, inputs, T_AIR_K)
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(simulate(office, theta, inputs), expected, rtol=0, atol=EXACT_K)
