"""The office as FMI 3.0 answers like the office as FMI 2.0, by our runner and by FMPy."""

import dataclasses
import shutil
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest

from simulation import load_case
from simulation.fmi.fmu import FmuSettings

REPOSITORY = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def office_3(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("gcc") is None or fmpy.platform != "linux64":
        pytest.skip("needs gcc on Linux to build the office as FMI 3.0")
    pytest.importorskip("pymoca")
    folder = tmp_path_factory.mktemp("office3")
    source = REPOSITORY / "fmus" / "office"
    shutil.copy(source / "Office.mo", folder)
    build = 'fmi_version = "3.0"\n' + (source / "build.toml").read_text()
    (folder / "build.toml").write_text(build)
    command = [sys.executable, "-m", "fmus.compiler", folder]
    subprocess.run(command, cwd=REPOSITORY, check=True, capture_output=True)
    return folder / "Office.fmu"


@pytest.fixture(scope="module")
def settings(office_folder: Path) -> FmuSettings:
    if not (REPOSITORY / "data" / "office" / "recording_1800s.csv").exists():
        pytest.skip("needs data/office/recording_1800s.csv")
    return load_case(office_folder).settings


def test_the_office_of_both_versions_is_the_same_to_the_last_bit(settings: FmuSettings, office_3: Path):
    rows = settings.parameter_space.from_unit(
        np.random.default_rng(3).random((20, settings.parameter_space.n_parameters))
    )
    with settings.open() as model:
        two = model.simulate(rows)
    with dataclasses.replace(settings, path=office_3).open() as model:
        three = model.simulate(rows)
    assert two.failures == three.failures == ("",) * 20
    assert np.array_equal(two.y, three.y)


def test_fmpy_answers_the_same_with_the_inputs_held(settings: FmuSettings, office_3: Path):
    settings = dataclasses.replace(settings, path=office_3)
    scenario = settings.scenario
    row = settings.parameter_space.from_unit(np.full((1, settings.parameter_space.n_parameters), 0.5))
    with settings.open() as model:
        ours = model.simulate(row).y[0]
    description = fmpy.read_model_description(str(office_3))
    references = {variable.name: variable.valueReference for variable in description.modelVariables}
    folder = fmpy.extract(str(office_3))
    try:
        fmu = fmpy.fmi3.FMU3Slave(
            guid=description.guid,
            unzipDirectory=folder,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="office",
        )
        fmu.instantiate()
        values = dict(zip(settings.parameter_space.names, row[0], strict=True)) | dict(settings.fixed)
        fmu.setFloat64([references[name] for name in values], list(values.values()))
        edges = scenario.time_communication
        fmu.enterInitializationMode(startTime=edges[0], stopTime=edges[-1])
        inputs = [references[name] for name in scenario.input_names]
        outputs = [references[name] for name in settings.output_names]
        fmu.setFloat64(inputs, scenario.inputs[0])
        fmu.exitInitializationMode()
        y = [fmu.getFloat64(outputs)]
        for t, end, u in zip(edges[:-1], edges[1:], scenario.inputs, strict=True):
            fmu.setFloat64(inputs, u)
            fmu.doStep(t, end - t)
            y.append(fmu.getFloat64(outputs))
        fmu.freeInstance()
    finally:
        shutil.rmtree(folder)
    theirs = np.array(y)[:: scenario.output_every][scenario.n_warmup :] + settings.output_offsets
    assert np.array_equal(ours, theirs)
