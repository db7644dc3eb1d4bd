"""Cases around FMUs with other descriptions: own units, initial states, parameters that are no numbers."""

from pathlib import Path

import numpy as np
import pytest
from case_for_tests import edit, repack

from simulation import InputError, load_case

X0 = (
    b'<ScalarVariable name="x0" valueReference="1" causality="parameter" variability="tunable">\n'
    b'<Real start="300" unit="K"/></ScalarVariable>'
)
OTHERS = b"""
<ScalarVariable name="n" valueReference="10" causality="parameter" variability="fixed">
<Integer start="1"/></ScalarVariable>
<ScalarVariable name="on" valueReference="11" causality="parameter" variability="fixed">
<Boolean start="true"/></ScalarVariable>
<ScalarVariable name="file" valueReference="12" causality="parameter" variability="fixed">
<String start="a.txt"/></ScalarVariable>
<ScalarVariable name="kind" valueReference="13" causality="parameter" variability="fixed">
<Enumeration declaredType="Kind" start="1"/></ScalarVariable>
</ModelVariables>"""
TYPES = b"""<TypeDefinitions><SimpleType name="Kind"><Enumeration>
<Item name="plain" value="1"/><Item name="wrapped" value="4"/>
</Enumeration></SimpleType></TypeDefinitions>
<ModelVariables>"""
UNITS = b"""<UnitDefinitions>
<Unit name="K"><BaseUnit K="1"/><DisplayUnit name="degRe" factor="0.8" offset="-218.52"/></Unit>
<Unit name="1/s"/><Unit name="K/s"/><Unit name="crate"><BaseUnit kg="1" m="2" s="-3" factor="2500"/></Unit>"""


def describe(folder: Path, *pairs: tuple[bytes, bytes]) -> None:
    """Change the FMU's description."""

    def change(members: dict[str, bytes]) -> dict[str, bytes]:
        text = members["modelDescription.xml"]
        for old, new in pairs:
            assert old in text
            text = text.replace(old, new)
        return members | {"modelDescription.xml": text}

    repack(folder / "decay.fmu", change)


def local(initial: bytes) -> tuple[bytes, bytes]:
    return X0, X0.replace(b'"parameter" variability="tunable"', b'"local" variability="continuous"' + initial)


def test_an_initial_state_can_be_calibrated_and_fixed(decay_case: Path):
    describe(decay_case, local(b' initial="exact"'))
    assert load_case(decay_case).fixed["x0"] > 290.0
    edit(
        decay_case,
        ('name = "mode"\nlower = 0\nupper = 6', 'name = "x0"\nlower = 10\nupper = 30\nunit = "degC"'),
        ('x0 = { first_measured = "y" }', "mode = 0"),
    )
    with load_case(decay_case).open_model() as model:
        y = model.simulate(np.array([[1e-4, 12.0], [1e-4, 28.0]])).y
    np.testing.assert_allclose(y[:, 0, 0], [12.0, 28.0], atol=1e-9)


def test_a_state_whose_start_is_computed_is_no_parameter(decay_case: Path):
    describe(decay_case, local(b""))
    with pytest.raises(InputError, match=r"fixed\.x0: x0 is a local of decay\.fmu, not parameter"):
        load_case(decay_case)


NO_UNIT = (X0, X0.replace(b' unit="K"', b""))
Y_WITHOUT_UNIT = (b'<Real unit="K"/>', b"<Real/>")


@pytest.mark.parametrize(("said", "changed"), [("", []), ('\nfmu_unit = "K"', [Y_WITHOUT_UNIT])])
def test_a_first_measured_value_gets_the_output_s_unit_where_the_parameter_has_none(
    decay_case: Path, said: str, changed: list[tuple[bytes, bytes]]
):
    with_units = load_case(decay_case).fixed["x0"]
    describe(decay_case, NO_UNIT, *changed)
    edit(decay_case, ('unit = "degC"', f'unit = "degC"{said}'))
    assert load_case(decay_case).fixed["x0"] == with_units > 273.15


@pytest.mark.parametrize(
    ("fixed", "remedy"),
    [
        ('{ first_measured = "y" }', r"none for y; say in outputs\[y\] .* as fmu_unit, or give a number"),
        ('{ value = 20.0, unit = "degC" }', r"so 20 degC cannot be converted; give the number alone"),
    ],
)
def test_a_value_whose_unit_the_fmu_does_not_say_is_refused(decay_case: Path, fixed: str, remedy: str):
    describe(decay_case, NO_UNIT, Y_WITHOUT_UNIT)
    edit(decay_case, ('{ first_measured = "y" }', fixed))
    with pytest.raises(InputError, match=rf"fixed\.x0: the FMU declares no unit for x0.* {remedy}"):
        load_case(decay_case)
    edit(decay_case, (f"x0 = {fixed}", "x0 = 293.15"))
    assert load_case(decay_case).fixed["x0"] == 293.15


def test_the_fmu_s_display_units_are_units(decay_case: Path):
    plain = load_case(decay_case)
    describe(decay_case, (b'<UnitDefinitions><Unit name="K"/><Unit name="1/s"/><Unit name="K/s"/>', UNITS))
    edit(decay_case, ('unit = "degC"', 'unit = "degRe"'), ('{ first_measured = "y" }', "300.0"))
    with load_case(decay_case).open_model() as model, plain.open_model():
        y = model.simulate(np.array([[1e-4, 0.0]])).y
    assert y[0, 0, 0] == pytest.approx((300.0 - 273.15) * 0.8, abs=1e-9)


@pytest.mark.parametrize(
    ("line", "value"),
    [
        ("n = 5", 5),
        ('file = "b.txt"', "b.txt"),
        ('kind = "wrapped"', 4),
    ],
)
def test_what_is_no_number_can_be_fixed(decay_case: Path, line: str, value: object):
    describe(decay_case, (b"</ModelVariables>", OTHERS), (b"<ModelVariables>", TYPES))
    before = load_case(decay_case)
    edit(decay_case, ("[fixed]", f"[fixed]\n{line}"))
    case = load_case(decay_case)
    name = line.split(" ")[0]
    assert case.fixed[name] == value
    assert type(case.fixed[name]) is type(value)
    assert case.model_digest != before.model_digest
