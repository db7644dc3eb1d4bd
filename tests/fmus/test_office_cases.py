"""The case files against the FMU and the paper; the recorded case against numbers that are known."""

import office_equations as reference
import pytest
from fmu_for_tests import REPOSITORY

from simulation.case_reading import read_experiments

FMUS = REPOSITORY / "fmus"


@pytest.mark.parametrize("name", ["office", "office-recorded", "office-authors"])
def test_parameters_are_those_of_the_paper(name):
    case = read_experiments(FMUS / name / "case.toml")[0].file
    found = [(p.name, p.estimate, p.lower, p.upper, p.unit) for p in case.parameters]
    expected = [list(row) for row in reference.TABLE]
    if name == "office-authors":
        expected[reference.NAMES.index("VSUP")][0] = "VSup"
        # The authors' FMU declares that unit, and a case that says another one does not open.
        expected[reference.NAMES.index("fSol")][4] = "1"
    assert found == [tuple(row) for row in expected]
    assert {p.name for p in case.parameters if p.scale == "linear"} == {"TTABSInit"}
    assert case.name == name
    assert case.note


def test_the_recorded_case_differs_from_the_default_in_its_data_alone():
    office, recorded = (
        read_experiments(FMUS / name / "case.toml")[0].file for name in ("office", "office-recorded")
    )
    assert recorded.data == "../../data/office-recorded"
    own = {"name", "title", "note", "fmu", "data", "data_origin", "references"}
    assert office.model_dump(exclude=own) == recorded.model_dump(exclude=own)
