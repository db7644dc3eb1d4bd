"""The doctor on the real office, on a sound case and on spoilt ones."""

from pathlib import Path

import pytest
from project_for_tests import Run

EXAMINED = {
    "names, units, bounds",
    "data",
    "estimates",
    "corners of the box",
    "box covers the measurement",
    "every parameter moves an output",
    "reset equals fresh",
    "half the communication step (300 s)",
    "cost of profile smoke",
}


def edit(file: Path, old: str, new: str) -> None:
    text = file.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_the_office_is_sound(project: Path, studies: Run) -> None:
    answer = studies("check", "--profile", "smoke", "--json")
    document = answer.document
    assert answer.code == 0, document
    assert document["sound"]
    assert {found["what"] for found in document["findings"]} == EXAMINED
    assert all(found["level"] != "fail" for found in document["findings"])
    assert all(found["remedy"] for found in document["findings"] if found["level"] != "ok")
    assert 0.0 < document["simulation_s"] < 1.0
    # n_base (p + 2) for 14 parameters
    assert document["planned_simulations"]["sensitivity"] == 8 * 16
    assert document["planned_simulations"]["training"] == 32


def test_findings_are_a_table_for_people(project: Path, studies: Run) -> None:
    answer = studies("check", "--profile", "smoke")
    assert "what to do" in answer.out
    assert "0 failed" in answer.out.splitlines()[-1]


def test_a_parameter_without_effect_fails_and_is_named(project: Path, studies: Run) -> None:
    # Ventilation that never runs leaves its flow without effect.
    case = project / "fmus" / "office" / "case.toml"
    edit(case, 'column = "RLTFlow"', "sum = { RLTFlow = 0.0 }")
    answer = studies("check", "--profile", "smoke", "--json")
    (finding,) = [f for f in answer.document["findings"] if f["what"] == "every parameter moves an output"]
    assert answer.code == 1
    assert finding["level"] == "fail"
    assert "VSUP" in finding["found"]
    assert finding["remedy"]


def test_a_measurement_out_of_reach_is_worth_a_look(project: Path, studies: Run) -> None:
    recording = project / "data" / "office" / "recording_1800s.csv"
    lines = recording.read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines[1:]]
    warm = [",".join([row[0], f"{float(row[1]) + 100.0:.6f}", *row[2:]]) for row in rows]
    recording.write_text("\n".join([lines[0], *warm]) + "\n", encoding="utf-8")
    edit(
        project / "fmus" / "office" / "case.toml",
        'TAirInit = { first_measured = "TAir" }',
        "TAirInit = 295.15",
    )
    answer = studies("check", "--profile", "smoke", "--json")
    (finding,) = [f for f in answer.document["findings"] if f["what"] == "box covers the measurement"]
    assert answer.code == 0
    assert finding["level"] == "warn"
    assert "bounds" in finding["remedy"]


@pytest.mark.parametrize("command", ["check", "run"])
def test_an_unsound_case_ends_with_one(project: Path, studies: Run, command: str) -> None:
    case = project / "fmus" / "office" / "case.toml"
    edit(case, 'column = "RLTFlow"', "sum = { RLTFlow = 0.0 }")
    answer = studies(command, "--profile", "smoke")
    assert answer.code == 1
    assert "1 failed" in answer.out
    assert not (project / "data" / "office" / "generated").exists()
