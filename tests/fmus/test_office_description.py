"""What the office FMU says about itself and what it carries."""

import subprocess
import zipfile

import office_equations as reference
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from fmu_for_tests import OFFICE


@pytest.fixture(scope="module")
def description():
    return read_model_description(str(OFFICE))


def test_fmpy_finds_no_problem():
    assert validate_fmu(str(OFFICE)) == []


def test_parameters_are_those_of_the_paper(description):
    by_name = {v.name: v for v in description.modelVariables if v.causality == "parameter"}
    for name, estimate, lower, upper, unit in reference.TABLE:
        variable = by_name.pop(name)
        assert (float(variable.start), float(variable.min), float(variable.max)) == (estimate, lower, upper)
        assert variable.unit == unit
    assert {name: (float(v.start), v.unit) for name, v in by_name.items()} == {
        "TAirInit": (296.15, "K"),
        "TWallInit": (280.0, "K"),
    }


def test_every_variable_has_a_unit_and_a_description(description):
    defined = {unit.name: unit for unit in description.unitDefinitions}
    for variable in description.modelVariables:
        assert variable.unit in defined, variable.name
        assert variable.description, variable.name
        assert defined[variable.unit].baseUnit is not None


def test_both_interfaces_offer_states_and_derivatives(description):
    for interface in (description.coSimulation, description.modelExchange):
        assert interface.canGetAndSetFMUstate
        assert interface.canSerializeFMUstate
        assert interface.providesDirectionalDerivative
    assert description.coSimulation.canHandleVariableCommunicationStepSize
    assert description.numberOfContinuousStates == 4
    experiment = description.defaultExperiment
    assert (float(experiment.stopTime), float(experiment.stepSize)) == (864000.0, 600.0)


def test_only_fmi_functions_are_exported(tmp_path):
    with zipfile.ZipFile(OFFICE) as archive:
        binary = archive.extract("binaries/linux64/Office.so", tmp_path)
    try:
        listing = subprocess.run(
            ["nm", "-D", "--defined-only", binary], capture_output=True, text=True, check=True
        ).stdout
    except FileNotFoundError:
        pytest.skip("nm (binutils) is not installed")
    names = {line.split()[-1] for line in listing.splitlines()}
    assert len(names) == 44
    assert all(name.startswith("fmi2") for name in names)
