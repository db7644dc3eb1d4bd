"""The office FMU against the paper's equations, solved in two independent ways."""

import numpy as np
import office_equations as reference
import pytest

# Both solutions are exact up to rounding: 300 K times a few hundred roundings.
EXACT_K = 1e-9
# What the ODE solver leaves at its tolerance of 1e-10 over 144 restarts.
SOLVER_K = 1e-6
T_AIR_K = 296.22


def simulate(office, theta, inputs):
    first = dict(zip(reference.INPUTS, inputs[0], strict=True))
    office.initialize(**dict(zip(reference.NAMES, theta, strict=True)), TAirInit=T_AIR_K, **first)
    return np.array(office.run(reference.INPUTS, inputs, reference.STEP_S, "TAir"))


@pytest.mark.parametrize("seed", range(6))
def test_the_matrix_exponential_gives_the_same_air_temperature(office, seed):
    theta = reference.random_theta(1, seed)[0]
    inputs = reference.varied_inputs(432, seed)
    expected = reference.solve_exactly(theta, inputs, T_AIR_K)
    assert np.ptp(expected) > 1.0
    np.testing.assert_allclose(simulate(office, theta, inputs), expected, rtol=0, atol=EXACT_K)


@pytest.mark.parametrize("corner", ["lower", "upper"])
def test_it_holds_at_the_corners_of_the_bounds(office, corner):
    theta = reference.LOWER if corner == "lower" else reference.UPPER
    inputs = reference.varied_inputs(144, 7)
    expected = reference.solve_exactly(theta, inputs, T_AIR_K)
    np.testing.assert_allclose(simulate(office, theta, inputs), expected, rtol=0, atol=EXACT_K)


@pytest.mark.parametrize("seed", [10, 11])
def test_a_tight_ode_solver_gives_the_same_air_temperature(office, seed):
    theta = reference.random_theta(1, seed)[0]
    inputs = reference.varied_inputs(144, seed)
    expected = reference.solve_tightly(theta, inputs, T_AIR_K)
    np.testing.assert_allclose(simulate(office, theta, inputs), expected, rtol=0, atol=SOLVER_K)


def test_the_two_references_are_one_system():
    theta = reference.random_theta(1, 5)[0]
    row = reference.varied_inputs(3, 5)[2]
    temperatures = np.array([295.0, 296.0, 281.0, 299.0])
    matrix, source = reference.network(theta, row)
    np.testing.assert_allclose(
        matrix @ temperatures + source, reference.right_side(temperatures, theta, row), rtol=1e-9
    )


def test_smaller_steps_with_the_same_inputs_change_nothing(office):
    theta = reference.random_theta(1, 3)[0]
    inputs = reference.varied_inputs(72, 3)
    coarse = simulate(office, theta, inputs)
    first = dict(zip(reference.INPUTS, inputs[0], strict=True))
    office.initialize(**dict(zip(reference.NAMES, theta, strict=True)), TAirInit=T_AIR_K, **first)
    fine = office.run(reference.INPUTS, np.repeat(inputs, 10, axis=0), reference.STEP_S / 10, "TAir")
    np.testing.assert_allclose(fine[::10], coarse, rtol=0, atol=EXACT_K)


def test_a_reset_instance_repeats_bit_for_bit(office):
    thetas = reference.random_theta(2, 4)
    inputs = reference.varied_inputs(72, 4)
    first = simulate(office, thetas[0], inputs)
    simulate(office, thetas[1], inputs)
    np.testing.assert_array_equal(simulate(office, thetas[0], inputs), first)


@pytest.mark.parametrize("name", reference.NAMES)
def test_every_parameter_moves_the_air_temperature(office, name):
    inputs = reference.varied_inputs(288, 1)
    theta = np.array([row[1] for row in reference.TABLE])
    before = simulate(office, theta, inputs)
    theta[reference.NAMES.index(name)] *= 1.1 if name != "TTABSInit" else 1.01
    # A tenth of a millikelvin is a hundred thousand roundings.
    assert np.max(np.abs(simulate(office, theta, inputs) - before)) > 1e-4


@pytest.mark.parametrize("name", ["TAirInit", "TWallInit"])
def test_the_other_start_temperatures_act_too(office, name):
    inputs = reference.varied_inputs(12, 1)
    names = dict(zip(reference.INPUTS, inputs[0], strict=True))
    office.initialize(**names)
    before = office.run(reference.INPUTS, inputs, reference.STEP_S, "TAir")
    office.initialize(**names, **{name: 290.0})
    assert office.run(reference.INPUTS, inputs, reference.STEP_S, "TAir")[-1] != before[-1]


@pytest.mark.parametrize(
    ("signal", "is_on"), [(0.1, False), (np.nextafter(0.1, 1.0), True), (-1.0, False), (3.0, True)]
)
def test_a_circuit_is_on_while_its_signal_exceeds_the_threshold(office, signal, is_on):
    office.initialize(ySupMV=signal, TSupMV=283.15)
    off = {"ySupMV": 0.0, "TSupMV": 283.15}
    (slope,) = office.get("der(air.T)")
    office.initialize(**off)
    assert (slope < office.get("der(air.T)")[0] - 1e-6) == is_on
