"""Model exchange, directional derivatives and saved states of the office FMU."""

import numpy as np
import office_equations as reference
import pytest

STATES = ("air.T", "masses.T", "wall.T", "ceiling.T")
DERIVATIVES = tuple(f"der({name})" for name in STATES)


def enter_continuous_time(driver, **values):
    driver.initialize(**values)
    driver.fmu.newDiscreteStates()
    driver.fmu.enterContinuousTimeMode()


def set_states(driver, temperatures):
    array = np.ascontiguousarray(temperatures, dtype=np.float64)
    driver.fmu.setContinuousStates(array.ctypes.data_as(_pointer()), array.size)


def derivatives_of(driver):
    array = np.empty(4)
    driver.fmu.getDerivatives(array.ctypes.data_as(_pointer()), array.size)
    return array


def _pointer():
    from ctypes import POINTER, c_double

    return POINTER(c_double)


@pytest.mark.parametrize("seed", range(3))
def test_derivatives_are_those_of_the_paper(office_exchange, seed):
    theta = reference.random_theta(1, seed)[0]
    row = reference.varied_inputs(50, seed)[40]
    enter_continuous_time(office_exchange, **dict(zip(reference.NAMES, theta, strict=True)))
    office_exchange.set(**dict(zip(reference.INPUTS, row, strict=True)))
    temperatures = np.array([295.0, 296.5, 279.0, 300.0]) + seed
    set_states(office_exchange, temperatures)
    # Relative to the flows, of which a derivative is a difference.
    matrix, source = reference.network(theta, row)
    expected = matrix @ temperatures + source
    np.testing.assert_allclose(derivatives_of(office_exchange), expected, rtol=1e-10, atol=1e-15)
    assert office_exchange.get("TAir") == [295.0 + seed]


@pytest.mark.parametrize("known", [*STATES, *reference.INPUTS, *reference.NAMES])
def test_directional_derivatives_match_finite_differences(office_exchange, known):
    values = dict(zip(reference.NAMES, reference.random_theta(1, 8)[0], strict=True))
    values |= dict(zip(reference.INPUTS, [268.0, 271.0, 302.0, 1.0, 291.0, 1.0, 250.0, 0.6], strict=True))
    unknowns = [*DERIVATIVES, "TAir"]
    temperatures = np.array([295.0, 296.5, 279.0, 300.0])

    def evaluate(shift):
        changed = values | ({known: values[known] + shift} if known in values else {})
        enter_continuous_time(office_exchange, **changed)
        set_states(office_exchange, temperatures + shift * np.array([known == name for name in STATES]))
        return np.array(office_exchange.get(*unknowns))

    size = 1e-5 * (values[known] if known in reference.NAMES else 300.0 if known.endswith(".T") else 1.0)
    expected = (evaluate(size) - evaluate(-size)) / (2 * size)
    evaluate(0.0)
    given = office_exchange.fmu.getDirectionalDerivative(
        office_exchange.refer(unknowns), office_exchange.refer([known]), [1.0]
    )
    # Central differences of derivatives near 1e-3 K/s: rounding 1e-19 over the step, and its square.
    scale = max(np.max(np.abs(expected)), 1e-13)
    np.testing.assert_allclose(given, expected, rtol=1e-6, atol=1e-5 * scale)
    if known not in {"ySupTAC", "ySupMV", "TTABSInit"}:
        assert np.any(np.array(given) != 0.0)


def test_a_saved_state_goes_back_and_through_bytes(office):
    inputs = reference.varied_inputs(6, 2)
    office.initialize()
    office.run(reference.INPUTS, inputs[:3], 600.0, "TAir")
    saved = office.fmu.getFMUstate()

    def go_on():
        result = []
        for k, row in enumerate(inputs[3:], start=3):
            office.fmu.setReal(office.refer(reference.INPUTS), list(row))
            office.fmu.doStep(600.0 * k, 600.0)
            result += office.get("TAir")
        return result

    expected = go_on()
    office.fmu.setFMUstate(saved)
    assert go_on() == expected
    stored = office.fmu.serializeFMUstate(saved)
    office.fmu.freeFMUstate(saved)
    office.initialize(b=20.0)
    again = office.fmu.deSerializeFMUstate(stored)
    office.fmu.setFMUstate(again)
    office.fmu.freeFMUstate(again)
    assert go_on() == expected
