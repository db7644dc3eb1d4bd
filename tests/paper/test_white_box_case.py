"""The white-box office as a second model to calibrate: one room, two files of it, two recordings."""

import pytest
from fmpy import simulate_fmu
from paper_study_for_tests import REPOSITORY

from simulation.case_reading import read_case_file

FOLDER = REPOSITORY / "fmus" / "office-whitebox-metered"
FMU = FOLDER / "MeteredOffice.fmu"
ROOM = REPOSITORY / "fmus" / "office-whitebox" / "WhiteBoxOffice.fmu"
DAY_S = 86400.0


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
