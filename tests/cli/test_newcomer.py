"""A newcomer's way: an FMU of another tool, two CSV files, the lines marked EDIT, a calibrated result."""

import re
from pathlib import Path

import pytest
from foreign_fmu_for_tests import EFFICIENCY, HEAT_J_K, LOSS_W_K, build_heated_tank, write_recordings
from project_for_tests import Run


def test_from_a_foreign_fmu_to_calibrated_values(project: Path, studies: Run, tmp_path: Path) -> None:
    fmu = build_heated_tank(tmp_path)
    made = studies("new", str(fmu), "--json")
    assert made.code == 0, made.err
    assert made.document["next"] == ["studies check heatedtank", "studies calibrate heatedtank"]
    missing = studies("check", "heatedtank", "--profile", "smoke")
    assert missing.code == 2
    assert "data/heatedtank/measured.csv: no such file; it needs the columns time_s, T" in missing.err

    write_recordings(project / "data" / "heatedtank")
    case = project / "fmus" / "heatedtank" / "case.toml"
    lines = case.read_text(encoding="utf-8").splitlines()
    assert any(line.startswith('interface = "model-exchange"') for line in lines)
    for edit in made.document["edit"]:
        line = lines[edit["line"] - 1]
        assert line == edit["text"]
        if line.startswith('unit = "K"'):
            lines[edit["line"] - 1] = 'unit = "degC"'
        elif line.startswith("uncertainty"):
            lines[edit["line"] - 1] = "uncertainty = 0.05"
    text = "\n".join(lines)
    # The heater is switched; and the water's start is the first measured value.
    text = re.sub(r'(name = "P"(?:\n.*?)*?interpolation = )"linear"', r'\1"held"', text, count=1)
    text = text.replace("[fixed]", '[fixed]\nT = { first_measured = "T" }')
    case.write_text(text + "\n", encoding="utf-8")

    checked = studies("check", "heatedtank", "--profile", "smoke", "--json")
    assert checked.code == 0, checked.document
    assert {one["what"]: one["level"] for one in checked.document["findings"]}[
        "the same answer again"
    ] == "ok"

    fewest = studies("calibrate", "heatedtank", "--json")
    assert fewest.code == 0, fewest.err
    theta = fewest.stage["theta"]
    # The equation holds C, UA and eta up to a common factor: test what the data determine.
    assert theta["UA"] / theta["C"] == pytest.approx(LOSS_W_K / HEAT_J_K, rel=0.05)
    assert theta["eta"] / theta["C"] == pytest.approx(EFFICIENCY / HEAT_J_K, rel=0.05)
    assert fewest.stage["ledger"]["total_calls"] <= 60
