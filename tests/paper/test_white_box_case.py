"""The white-box office as a second model to calibrate: one room, two files of it, two recordings."""

import hashlib

import numpy as np
import pytest
from fmpy import simulate_fmu
from paper_study_for_tests import RECORDING, REPOSITORY

from simulation.case import load_case
from simulation.case_reading import read_case_file
from studies.paths import ProjectPaths, find_case

FOLDER = REPOSITORY / "fmus" / "office-whitebox-metered"
FMU = FOLDER / "MeteredOffice.fmu"
ROOM = REPOSITORY / "fmus" / "office-whitebox" / "WhiteBoxOffice.fmu"
DAY_S = 86400.0


def test_the_readme_has_the_checksum_of_the_fmu():
    assert hashlib.sha256(FMU.read_bytes()).hexdigest() in (FOLDER / "README.md").read_text()


def test_with_the_rooms_own_values_it_is_the_room():
    """In steady state, where it does not matter how slab and ceiling began."""
    weather = {"TAmb": 271.15, "TSupTAC": 301.15, "ySupTAC": 1.0, "TSupMV": 293.15, "ySupMV": 1.0}
    metered = weather | {"HGlo": 100.0, "occ": 0.5, "VSup": 0.015, "fFacade": 0.8, "dTSky": 12.0}
    room = weather | {
        "TSky": 271.15 - 12.0,
        "vWind": 3.5,
        "IDiffuse": 80.0,
        "nPeople": 0.5 * 0.45 * 150 / 70,
        "QEquipment": 30.0,
        "QLight": 11.25,
    }
    settings = {"stop_time": 150 * DAY_S, "output_interval": 10 * DAY_S, "fmi_type": "CoSimulation"}
    ends = []
    for fmu, starts, output in ((FMU, metered, "TRoom"), (ROOM, room, "TSensor")):
        result = simulate_fmu(str(fmu), start_values=starts, output=[output], **settings)
        assert abs(result[output][-1] - result[output][-2]) < 1e-4
        ends.append(result[output][-1])
    # Its values are rounded (0.94 for 40 and 30 W/(m2 K) in series), so a tenth of the sensor's uncertainty.
    assert ends[0] == pytest.approx(ends[1], abs=0.05)
    assert 285 < ends[0] < 305


def test_both_cases_are_one_room_but_for_the_data():
    metered, recorded = (read_case_file(FOLDER / f) for f in ("case.toml", "office-whitebox-recorded.toml"))
    own = {"name", "title", "note", "data", "data_origin", "references"}
    assert metered.model_dump(exclude=own) == recorded.model_dump(exclude=own)
    assert len(metered.parameters) == 21
    # Inputs are what the grey box has too, but for its equivalent outdoor temperature.
    grey = read_case_file(REPOSITORY / "fmus" / "office" / "case.toml")
    assert {one.name for one in grey.inputs} - {one.name for one in metered.inputs} == {"TAmbEq"}


@pytest.mark.parametrize("name", ["office-whitebox-metered", "office-whitebox-recorded"])
def test_cases_are_found_by_name(name):
    file = find_case(ProjectPaths(REPOSITORY), name)
    assert read_case_file(file).name == name


def test_the_room_moves_with_every_parameter():
    case = load_case(FOLDER, window_d=(0.0, 3.0))
    space = case.parameter_space
    u = np.tile(space.to_unit(np.array([one.estimate for one in space.parameters])), (22, 1))
    for i in range(21):
        u[i + 1, i] = min(u[i + 1, i] + 0.2, 1.0)
    with case.open_model() as model:
        answer = model.simulate(space.from_unit(u))
    assert not answer.failed.any()
    moved = np.abs(answer.y[1:] - answer.y[0]).max(axis=(1, 2))
    # The least of them, the inside of the furniture, by hundredths of a kelvin.
    assert moved.min() > 0.003


def test_the_recording_can_be_calibrated_against(tmp_path):
    if not RECORDING.is_dir():
        pytest.skip("needs the published recording in ../shared/data/office_recording")
    text = (FOLDER / "office-whitebox-recorded.toml").read_text()
    text = text.replace('"MeteredOffice.fmu"', f'"{FMU}"').replace(
        "../../data/office-recorded", str(RECORDING)
    )
    (tmp_path / "case.toml").write_text(text)
    case = load_case(tmp_path, window_d=(0.0, 1.0))
    with case.open_model() as model:
        y = model.simulate(np.array([[one.estimate for one in case.parameter_space.parameters]])).y
    assert case.measurement.mse(y)[0] < 4.0  # within a few kelvin, uncalibrated
