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


def test_smaller_steps_with_the_same_inputs_change_nothing(office):
    theta = reference.random_theta(1, 3)[0]
    inputs = reference.varied_inputs(72, 3)
    coarse = simulate(office, theta, inputs)
    first = dict(zip(reference.INPUTS, inputs[0], strict=True))
    office.initialize(**dict(zip(reference.NAMES, theta, strict=True)), TAirInit=T_AIR_K, **first)
    fine = office.run(reference.INPUTS, np.repeat(inputs, 10, axis=0), reference.STEP_S / 10, "TAir")
    np.testing.assert_allclose(fine[::10], coarse, rtol=0, atol=EXACT_K)


@pytest.mark.parametrize(
    ("signal", "is_on"), [(0.1, False), (np.nextafter(0.1, 1.0), True), (-1.0, False), (3.0, True)]
)
def test_a_circuit_is_on_while_its_signal_exceeds_the_threshold(office, signal, is_on):
    office.initialize(ySupMV=signal, TSupMV=283.15)
    off = {"ySupMV": 0.0, "TSupMV": 283.15}
    (slope,) = office.get("der(air.T)")
    office.initialize(**off)
    assert (slope < office.get("der(air.T)")[0] - 1e-6) == is_on
