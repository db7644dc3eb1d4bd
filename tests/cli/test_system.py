"""SSV files give a new case its estimates and fixed values; an SSP file with one FMU is a model."""

import tomllib
import zipfile
from pathlib import Path
from typing import Any

import pytest
from c_fmu_for_tests import write_fmu
from decaying_case_for_tests import SOURCE
from project_for_tests import Run

SSV = "http://ssp-standard.org/SSP1/SystemStructureParameterValues"
SSD = "http://ssp-standard.org/SSP1/SystemStructureDescription"
VALUES = '<p:Parameter name="k"><p:Real value="0.5" unit="1/h"/></p:Parameter>' + (
    '<p:Parameter name="x0"><p:Real value="21.5" unit="degC"/></p:Parameter>'
    '<p:Parameter name="mode"><p:Real value="0"/></p:Parameter>'
)


def ssv(values: str = VALUES) -> str:
    inside = f"<p:Parameters>{values}</p:Parameters>"
    return f'<p:ParameterSet xmlns:p="{SSV}" version="1.0" name="a">{inside}</p:ParameterSet>'


def ssd(binding: str, components: str = '<s:Component name="room" source="resources/decay.fmu"/>') -> str:
    return (
        f'<s:SystemStructureDescription xmlns:s="{SSD}" version="1.0" name="x"><s:System name="root">'
        f"<s:ParameterBindings>{binding}</s:ParameterBindings><s:Elements>{components}</s:Elements>"
        "</s:System></s:SystemStructureDescription>"
    )


@pytest.fixture
def fmu(tmp_path: Path) -> Path:
    return write_fmu(tmp_path / "decay.fmu", SOURCE.with_suffix(".xml").read_text(), SOURCE)


def packed(fmu: Path, structure: str, **members: str) -> Path:
    file = fmu.with_name("system.ssp")
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("SystemStructure.ssd", structure)
        archive.write(fmu, "resources/decay.fmu")
        for name, text in members.items():
            archive.writestr(f"resources/{name}.ssv", text)
    return file


def case_of(project: Path) -> dict[str, Any]:
    return tomllib.loads((project / "fmus" / "decay" / "case.toml").read_text())


def check(project: Path) -> None:
    """Check that k is calibrated around its value, and the others are held at theirs."""
    case = case_of(project)
    (k,) = case["parameters"]
    assert (k["name"], k["estimate"]) == ("k", pytest.approx(0.5 / 3600.0))
    assert k["lower"] < k["estimate"] < k["upper"]
    assert case["fixed"] == {"x0": pytest.approx(294.65), "mode": 0.0}


def test_values_of_a_file(project: Path, fmu: Path, studies: Run) -> None:
    fmu.with_name("values.ssv").write_text(ssv())
    answer = studies("new", str(fmu), "--parameter", "k", "--values", str(fmu.with_name("values.ssv")))
    assert answer.code == 0, answer.err
    check(project)


@pytest.mark.parametrize("is_inside", [True, False])
def test_a_system_with_one_fmu(project: Path, fmu: Path, studies: Run, is_inside: bool) -> None:
    """Values inside the description, by the name of the component, or in a file of their own."""
    values = ssv(VALUES.replace('name="', 'name="room.'))
    binding = f"<s:ParameterBinding><s:ParameterValues>{values}</s:ParameterValues></s:ParameterBinding>"
    if not is_inside:
        binding = '<s:ParameterBinding source="resources/own.ssv"/>'
    answer = studies("new", str(packed(fmu, ssd(binding), own=ssv())), "--parameter", "k")
    assert answer.code == 0, answer.err
    check(project)
    assert (project / "fmus" / "decay" / "decay.fmu").read_bytes() == fmu.read_bytes()


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ('<p:Parameter name="q"><p:Real value="1"/></p:Parameter>', "has no parameter named q"),
        ('<p:Parameter name="k"><p:Real value="much"/></p:Parameter>', "k = 'much' is no Real"),
        (
            '<p:Parameter name="k"><p:Real value="1" unit="kg"/></p:Parameter>',
            'values.ssv: k: unit = "kg" contradicts',
        ),
        ('<p:Parameter name="k"/>', "k has no value or two"),
        ('<p:Parameter name="k"><p:Boolean value="true"/></p:Parameter>', "k is of type Real; give a number"),
        ("<", "is not valid XML"),
    ],
)
def test_values_that_cannot_be_are_one_line(
    project: Path, fmu: Path, studies: Run, values: str, said: str
) -> None:
    fmu.with_name("values.ssv").write_text(ssv(values))
    answer = studies("new", str(fmu), "--values", str(fmu.with_name("values.ssv")))
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert said in answer.err


@pytest.mark.parametrize(
    ("structure", "said"),
    [
        (ssd("", ""), "has 0 FMUs; a case has one"),
        (ssd("", '<s:Component source="a.fmu"/><s:Component source="b.fmu"/>'), "has 2 FMUs"),
        (ssd('<s:ParameterBinding source="none.ssv"/>'), "has no none.ssv, which its system names"),
        (ssd("<s:ParameterBinding><s:ParameterMapping/></s:ParameterBinding>"), "maps names of parameters"),
        (ssd("", '<s:Component source="../../outside.fmu"/>'), "has no ../../outside.fmu"),
    ],
)
def test_a_system_that_cannot_be_is_one_line(
    project: Path, fmu: Path, studies: Run, structure: str, said: str
) -> None:
    answer = studies("new", str(packed(fmu, structure)))
    assert (answer.code, answer.err.count("\n")) == (2, 1)
    assert said in answer.err
    fmu.with_name("no.ssp").write_text("no zip")
    assert "is no SSP file" in studies("new", str(fmu.with_name("no.ssp"))).err
