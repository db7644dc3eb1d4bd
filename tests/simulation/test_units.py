"""Units: spellings, conversions against independent values, contradictions, the FMU's own definitions."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulation import InputError
from simulation.units import Conversion, Unit, UnitDefinition, conversion

KELVIN = Unit.of({"K": 1}, 1.0, 0.0)


# Values of the international system's brochure and of the units' definitions.
@pytest.mark.parametrize(
    ("declared", "model", "factor", "offset"),
    [
        ("degC", "K", 1.0, 273.15),
        ("K", "degC", 1.0, -273.15),
        ("degF", "degC", 5 / 9, -160 / 9),
        ("kWh", "J", 3.6e6, 0.0),
        ("bar", "Pa", 1e5, 0.0),
        ("l/s", "m3/s", 1e-3, 0.0),
        ("%", "1", 0.01, 0.0),
        ("mW/(m.K)", "W/(m.degC)", 1e-3, 0.0),
        ("rpm", "rad/s", 0.10471975511965977, 0.0),
        ("kOhm", "V/A", 1e3, 0.0),
    ],
)
def test_units_of_one_kind_are_converted(declared: str, model: str, factor: float, offset: float):
    found = conversion(declared, model, "here")
    # Rounded once, from exact fractions.
    assert found.factor == pytest.approx(factor, rel=3e-16)
    assert found.offset == pytest.approx(offset, rel=1e-15)


@given(st.sampled_from(["degC", "degF", "kWh", "l/s", "%"]), st.floats(-1e6, 1e6))
def test_a_conversion_and_its_inverse_are_the_identity(unit: str, value: float):
    model = {"degC": "K", "degF": "K", "kWh": "J", "l/s": "m3/h", "%": "1"}[unit]
    there = conversion(unit, model, "here")
    back = there.inverse
    assert (value * there.factor + there.offset) * back.factor + back.offset == pytest.approx(value, abs=1e-9)


@pytest.mark.parametrize(
    ("first", "second", "said"),
    [
        ("W", "K", "contradicts"),
        # A turn is an angle: 1 Hz is 2 pi rad/s, and who means which cannot be known.
        ("Hz", "rad/s", "contradicts"),
        # Heat flow and mass flow need a density or an enthalpy.
        ("kg/s", "m3/s", "contradicts"),
        ("cfm", "m3/s", "is not known"),
        ("kdegC", "K", "is not known"),
        ("degC", "own words", "contradicts"),
    ],
)
def test_other_units_contradict(first: str, second: str, said: str):
    with pytest.raises(
        InputError, match=rf'here: unit = ".*" {said}.* the FMU\'s "{re.escape(second)}"'
    ) as caught:
        conversion(first, second, "here")
    assert "\n" not in str(caught.value)


def test_the_fmu_s_own_units_go_first():
    definitions = {
        "rack": UnitDefinition(base=Unit.of({"kg": 1, "m": 2, "s": -3}, 2500.0, 0.0)),
        "K": UnitDefinition(base=KELVIN, displayed={"degRe": (0.8, -218.52), "degC": (1.0, -273.15)}),
    }
    # Declared in the FMU's unit, in a display unit, and in a unit of the same kind.
    assert conversion("kW", "rack", "here", definitions=definitions) == Conversion(0.4, 0.0)
    assert conversion("rack", "W", "here", definitions=definitions) == Conversion(2500.0, 0.0)
    reaumur = conversion("degRe", "K", "here", definitions=definitions)
    assert reaumur.factor == 1.25
    assert reaumur.offset == pytest.approx(273.15, rel=1e-15)
    assert conversion("degC", "K", "here", definitions=definitions) == Conversion(1.0, 273.15)


def test_an_fmu_whose_unit_is_not_what_its_name_says_is_not_believed():
    celsius_without_offset = {"degC": UnitDefinition(base=KELVIN)}
    with pytest.raises(InputError, match=r'the FMU defines its unit "degC" as something else'):
        conversion("K", "degC", "here", definitions=celsius_without_offset)
    # Nothing is converted, so nothing can be wrong.
    assert conversion("degC", "degC", "here", definitions=celsius_without_offset) == Conversion()
    # Leaving out the angle is common and harmless.
    no_angle = {"rpm": UnitDefinition(base=Unit.of({"s": -1}, 0.10471975511965977, 0.0))}
    assert conversion("rpm", "rpm", "here", definitions=no_angle) == Conversion()
