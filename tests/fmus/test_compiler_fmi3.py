"""FMI 3.0 from the compiler: the same numbers as FMI 2.0, saved states, derivatives, what is not offered."""

import shutil

import numpy as np
import pytest
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.fmi3 import FMU3Model, FMU3Slave
from fmpy.validation import validate_fmu
from fmu_for_tests import OFFICE, REPOSITORY

WALL = REPOSITORY / "fmus" / "wall" / "Wall.fmu"


class Driver3:
    """An instance of an FMI 3.0 FMU, the plainest way."""

    def __init__(self, fmu, folder, kind=FMU3Slave):
        self.description = read_model_description(str(fmu))
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.messages = []
        identifier = self.description.modelExchange.modelIdentifier
        self.fmu = kind(
            guid=self.description.guid,
            unzipDirectory=extract(str(fmu), unzipdir=str(folder)),
            modelIdentifier=identifier,
            instanceName="test",
        )
        self.fmu.instantiate(logMessage=lambda *said: self.messages.append(said[-1].decode()))

    def set(self, **values):
        for name, value in values.items():
            self.fmu.setFloat64([self.references[name]], [value])

    def get(self, *names):
        return self.fmu.getFloat64([self.references[name] for name in names])

    def initialize(self, **values):
        self.fmu.reset()
        self.set(**values)
        self.fmu.enterInitializationMode(startTime=0.0)
        self.fmu.exitInitializationMode()

    def derivative(self, unknown, known):
        unknowns, knowns = [self.references[unknown]], [self.references[known]]
        return self.fmu.getDirectionalDerivative(unknowns, knowns, [1.0])[0]

    def close(self):
        self.fmu.freeInstance()


@pytest.fixture
def wall(tmp_path):
    driver = Driver3(WALL, tmp_path / "wall")
    yield driver
    driver.close()


def test_the_office_answers_the_same_bits_in_both_versions(compiler, tmp_path):
    folder = tmp_path / "office"
    shutil.copytree(OFFICE.parent, folder, ignore=shutil.ignore_patterns("*.fmu"))
    with (folder / "build.toml").open("a") as settings:
        settings.write('fmi_version = "3.0"\n')
    fmu = compiler.build_fmu(folder)
    assert validate_fmu(str(fmu)) == []
    answers = [
        simulate_fmu(str(path), fmi_type="CoSimulation", stop_time=86400.0, output_interval=600.0)["TAir"]
        for path in (OFFICE, fmu)
    ]
    assert np.ptp(answers[0]) > 0.5
    np.testing.assert_array_equal(answers[0], answers[1])


def test_a_saved_state_goes_back_and_through_bytes(wall):
    def go_on():
        for k in range(5, 10):
            wall.fmu.doStep(600.0 * k, 600.0)
        return wall.get("TMasonry", "QRoom", "time")

    wall.initialize(C2=5e5)
    for k in range(5):
        wall.fmu.doStep(600.0 * k, 600.0)
    saved = wall.fmu.getFMUState()
    expected = go_on()
    wall.fmu.setFMUState(saved)
    assert go_on() == expected
    stored = wall.fmu.serializeFMUState(saved)
    wall.fmu.freeFMUState(saved)
    wall.initialize(C2=3e6)
    again = wall.fmu.deserializeFMUState(stored)
    wall.fmu.setFMUState(again)
    wall.fmu.freeFMUState(again)
    assert go_on() == expected


@pytest.mark.parametrize("known", ["T1", "T2", "T3", "TIn", "TOut", "GIn", "G12", "C1", "C3"])
def test_directional_derivatives_match_finite_differences(tmp_path, known):
    driver = Driver3(WALL, tmp_path / "wall", kind=FMU3Model)
    states = {"T1": 295.0, "T2": 285.0, "T3": 270.0}
    base = {"TIn": 296.0, "TOut": 268.0, "GIn": 60.0, "G12": 20.0, "C1": 2e5, "C3": 4e5}
    unknowns = ["der(T1)", "der(T2)", "der(T3)", "QRoom"]

    def evaluate(shift):
        values = {key: v + shift * (key == known) for key, v in (base | states).items()}
        starts = {f"{key}Start": values.pop(key) for key in states}
        driver.initialize(**values, **starts)
        return np.array(driver.get(*unknowns))

    size = 1e-4 * ({**base, **states}[known])
    expected = (evaluate(size) - evaluate(-size)) / (2 * size)
    evaluate(0.0)
    given = [driver.derivative(unknown, known) for unknown in unknowns]
    driver.close()
    np.testing.assert_allclose(given, expected, rtol=1e-6, atol=1e-5 * np.abs(expected).max())
    assert np.any(given)


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_model_exchange_only_offers_no_co_simulation(build, tmp_path, version):
    source = 'model M "Test"\n  Real x(unit="1", start=1, fixed=true) "State";\n'
    source += '  output Real y(unit="1") "Output";\nequation\n  der(x) = -x/1000;\n  y = x;\nend M;'
    fmu = build(source, f'model = "M"\nmodel_exchange_only = true\nfmi_version = "{version}"\n')
    assert validate_fmu(str(fmu)) == []
    description = read_model_description(str(fmu))
    assert description.coSimulation is None
    assert description.modelExchange is not None
    answer = simulate_fmu(str(fmu), stop_time=1000.0, output_interval=100.0, relative_tolerance=1e-8)
    assert answer["y"][-1] == pytest.approx(np.exp(-1.0), abs=1e-6)
    if version == "3.0":
        with pytest.raises(Exception, match="instantiate"):
            Driver3(fmu, tmp_path / "unpacked")
