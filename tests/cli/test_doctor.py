"""The doctor on the real office, on a sound case and on spoilt ones."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from bad_cases_for_tests import counted, make_bad_case
from project_for_tests import Answer, Run, edit

from simulation.case import load_case
from simulation.case_reading import read_experiments
from simulation.trajectories import Trajectories
from studies.doctor.answers import look_at_order
from studies.doctor.declared import look_at_data
from studies.doctor.examination import EXAMINATION_S, TimeBudget
from studies.doctor.means import rows_for_means

EXAMINED = {
    "names, units, bounds",
    "FMU",
    "data",
    "estimates",
    "corners of the box",
    "box covers the measurement",
    "every parameter moves an output",
    "every input moves an output",
    "the same answer again",
    "the same answer in any order",
    "half the communication step (300 s)",
    "time of a simulation",
}


def finding(answer: Answer, what: str) -> dict[str, Any]:
    (found,) = [one for one in answer.document["findings"] if one["what"] == what]
    assert isinstance(found, dict)
    return found


def test_the_office_is_sound(project: Path, studies: Run) -> None:
    answer = studies("check", "--profile", "smoke", "--json")
    document = answer.document
    assert answer.code == 0, document
    assert document["sound"]
    assert {found["what"] for found in document["findings"]} == EXAMINED
    assert all(found["level"] != "fail" for found in document["findings"])
    assert all(found["remedy"] for found in document["findings"] if found["level"] != "ok")
    estimates = next(found["found"] for found in document["findings"] if found["what"] == "estimates")
    assert re.match(r"MSE [0-9.]+ K², TAir from [0-9.]+ to [0-9.]+ ", estimates)
    assert 0.0 < document["simulation_s"] < 1.0


@pytest.mark.slow
def test_a_parameter_without_effect_fails_and_is_named(project: Path, studies: Run) -> None:
    # Ventilation that never runs leaves its flow without effect.
    case = project / "fmus" / "office" / "case.toml"
    edit(case, ('column = "RLTFlow"', "sum = { RLTFlow = 0.0 }"))
    answer = studies("check", "--profile", "smoke", "--json")
    (finding,) = [f for f in answer.document["findings"] if f["what"] == "every parameter moves an output"]
    assert answer.code == 1
    assert finding["level"] == "fail"
    assert "VSUP" in finding["found"]
    assert finding["remedy"]


@pytest.mark.slow
def test_a_measurement_out_of_reach_is_worth_a_look(project: Path, studies: Run) -> None:
    recording = project / "data" / "office" / "recording_1800s.csv"
    table = pandas.read_csv(recording)
    table["TRoom_degC"] += 100.0
    table.to_csv(recording, index=False)
    edit(
        project / "fmus" / "office" / "case.toml",
        ('TAirInit = { first_measured = "TAir" }', "TAirInit = 295.15"),
    )
    answer = studies("check", "--profile", "smoke", "--json")
    (finding,) = [f for f in answer.document["findings"] if f["what"] == "box covers the measurement"]
    assert answer.code == 0
    assert finding["level"] == "warn"
    assert "bounds" in finding["remedy"]


@pytest.mark.parametrize(
    ("failures", "remedy"),
    [
        (("", ""), ""),
        (("a", "did not answer within 1 s and was stopped"), ""),
        (("", "did not answer within 1 s and was stopped"), "timeout_s"),
        (("did not answer within 1 s and was stopped", ""), "timeout_s"),
        (("", "SIGSEGV"), "a process of its own"),
    ],
)
def test_a_time_out_is_no_sign_of_what_an_fmu_keeps(failures: tuple[str, str], remedy: str) -> None:
    later, first = (
        Trajectories.checked(
            np.ones((1, 1)),
            np.ones((1, 2, 1)),
            time=np.arange(2.0),
            parameter_names=("k",),
            output_names=("y",),
            failures=[failure],
        )
        for failure in failures
    )
    finding = look_at_order(later, first)
    assert finding.level == ("warn" if remedy else "ok")
    assert remedy in finding.remedy


@pytest.mark.parametrize(
    ("behaviour", "code", "what", "level", "found", "remedy"),
    [
        # `trouble` does nothing but make the FMU fail: no effect, though one of its bounds fails.
        ("CRASH", 1, "corners of the box", "warn", "corners failed; the reason: ", "narrow"),
        ("HANG", 1, "corners of the box", "warn", "did not answer within 1 s", "narrow the bounds"),
        ("LICENCE", 1, "opening the FMU", "fail", "no licence for", "max_workers"),
        (
            "UNITS",
            0,
            "units of the outputs",
            "warn",
            "K is too cold: the values are probably in degC",
            "fmu_unit",
        ),
        ("FROZEN", 0, "the same answer again", "ok", "bit for bit", ""),
        ("ICED", 0, "the same answer in any order", "warn", "of 8 simulations are others", "of its own"),
        ("RANDOM", 1, "the same answer again", "fail", "two new processes", "random numbers"),
    ],
)
def test_an_fmu_that_misbehaves_costs_one_line(
    project: Path, studies: Run, behaviour: str, code: int, what: str, level: str, found: str, remedy: str
) -> None:
    make_bad_case(project, behaviour)
    answer = studies("check", "bad", "--profile", "smoke", "--json")
    assert answer.code == code, answer.out
    line = finding(answer, what)
    assert line["level"] == level
    assert found in line["found"]
    assert remedy in line["remedy"]


def test_a_bound_that_fails_is_named_with_where_that_begins_and_why(project: Path, studies: Run) -> None:
    make_bad_case(project, "ERROR")
    answer = studies("check", "bad", "--profile", "smoke", "--json")
    line = finding(answer, "every parameter reaches its bounds")
    assert line["level"] == "warn"
    # Half of the way that is left, five times.
    said = re.match(
        r"trouble fails above (0\.9\d+), at its upper bound 1 \(17 % of the bounds\)", line["found"]
    )
    assert said
    assert 0.96 < float(said[1]) < 0.995
    assert line["found"].endswith("the valve is stuck")


def test_what_the_doctor_simulates_is_kept(
    project: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_bad_case(project, "GOOD")
    file = project / "fmus" / "bad" / "case.toml"
    # Without trouble there is no parameter without effect.
    head, rest = file.read_text(encoding="utf-8").split('[[parameters]]\nname = "trouble"')
    file.write_text(head + rest[rest.index("[fixed]") :], encoding="utf-8")
    count = project / "count"
    monkeypatch.setenv("BAD_FMU_COUNT", str(count))
    said = studies("check", "bad", "--profile", "smoke")
    assert said.code == 0, said.out
    first = counted(count)
    assert studies("check", "bad", "--profile", "smoke").code == 0
    again = counted(count) - first
    # The estimates, 4 moves of a parameter, 4 corners and 64 points all over the box.
    n_first = 1 + 4 + 4 + 64
    # Further ones look for means in place of moments.
    assert n_first <= len(first) <= n_first + rows_for_means(load_case(file))
    # Only whether it repeats has to be asked anew: the estimates, and points in two orders.
    assert len(again) <= 8


def test_data_that_cannot_be_right_are_worth_a_look(project: Path) -> None:
    file = project / "fmus" / "office" / "case.toml"
    kelvin = ('column = "TEnv_degC"\nunit = "degC"', 'column = "TEnv_degC"\nunit = "K"')
    edit(file, kelvin, ('column = "FlowSupply"', "sum = { FlowSupply = 0.0 }"))
    found = {one.what: one for one in look_at_data(load_case(file))}
    assert found["units of the data"].level == "warn"
    assert "TAmb" in found["units of the data"].found
    assert "ySupTAC" in found["series that never change"].found


@pytest.mark.parametrize(("value", "is_named"), [("-9999", True), ("9999", False)])
def test_an_input_that_no_sensor_meant_is_worth_a_look_and_a_rare_peak_is_not(
    project: Path, value: str, is_named: bool
) -> None:
    # One cell of half an hour is many values where inputs are interpolated.
    case = load_case(project / "fmus" / "office")
    (recording,) = {one.file for one in read_experiments(case.path)[0].file.inputs if one.name == "TAmb"}
    file = project / "data" / "office" / recording
    table = pandas.read_csv(file)
    table.loc[99, "TEnv_degC"] = float(value)
    table.to_csv(file, index=False)
    found = {one.what: one.found for one in look_at_data(load_case(project / "fmus" / "office"))}
    said = found.get("values far from all others", "")
    assert said.startswith("TAmb: -") == is_named
    assert ("the others lie between" in said) == is_named
    assert "units of the data" not in found


def test_a_slow_model_is_examined_with_as_few_simulations_as_fit() -> None:
    fast = TimeBudget(2, False, None, simulation_s=0.001)
    assert fast.rows("corners", 32) == 32
    assert not fast.left_out
    slow = TimeBudget(2, False, None, simulation_s=EXAMINATION_S / 10)
    assert 16 <= slow.rows("corners", 32) <= 20
    assert slow.rows("coverage", 64, least=30) == 0
    assert slow.left_out[0].startswith("corners (")
    assert slow.left_out[1] == "coverage"
    hours = TimeBudget(2, False, None, simulation_s=3600.0)
    assert hours.rows("corners", 32) == 0
    assert TimeBudget(2, True, None, simulation_s=3600.0).rows("corners", 32) == 32
