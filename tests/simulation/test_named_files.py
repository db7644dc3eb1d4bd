"""What an FMU answers depends on the files that its texts name: their content is part of its digest."""

import os
from pathlib import Path

import numpy as np
import pytest
from c_fmu_for_tests import write_fmu

from simulation.case import Case, load_case

SOURCE = Path(__file__).with_name("table_reader.c")
_VARIABLE = (
    '<ScalarVariable name="{}" valueReference="{}" causality="{}" variability="{}">{}</ScalarVariable>'
)
_VARIABLES = (
    _VARIABLE.format("a", 0, "parameter", "fixed", '<Real start="0"/>'),
    _VARIABLE.format("y", 1, "output", "continuous", "<Real/>"),
    _VARIABLE.format("file", 2, "parameter", "fixed", '<String start="{start}"/>'),
)
DESCRIPTION = f"""<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="reader" guid="reader">
<CoSimulation modelIdentifier="table_reader" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>{"".join(_VARIABLES)}</ModelVariables>
<ModelStructure><Outputs><Unknown index="2"/></Outputs></ModelStructure></fmiModelDescription>"""
CASE = """schema = 1
name = "reader"
fmu = "reader.fmu"
data = "."
[time]
window_s = [0, 3600]
communication_step_s = 600
output_step_s = 600
[[outputs]]
name = "y"
unit = "1"
file = "measured.csv"
column = "y"
uncertainty = 0.1
[[parameters]]
name = "a"
lower = -1
upper = 1
unit = "1"
"""


def reader(folder: Path, said: object = None, start: str = "") -> Case:
    """Return a case whose FMU reads the file that is said in the case, or that its own start value names."""
    folder.mkdir(exist_ok=True)
    write_fmu(folder / "reader.fmu", DESCRIPTION.format(start=start), SOURCE, "-w")
    rows = [f"{600 * step},1.0" for step in range(7)]
    (folder / "measured.csv").write_text("\n".join(["time_s,y", *rows]) + "\n")
    fixed = "" if said is None else f'[fixed]\nfile = "{said}"\n'
    (folder / "case.toml").write_text(CASE + fixed)
    return load_case(folder / "case.toml")


def answer(case: Case) -> float:
    with case.open_model() as model:
        return float(model.simulate(np.zeros((1, 1))).y[0, 0, 0])


@pytest.mark.parametrize("form", ["file", "folder", "address", "start"])
def test_another_content_is_another_model(tmp_path: Path, form: str) -> None:
    tables = tmp_path / "my tables"
    tables.mkdir()
    file = tables / "table.txt"
    file.write_text("0.5\n")
    # This FMU reads no addresses and has no start value inside; what these name counts all the same.
    said = {"file": file, "folder": tables, "address": file.as_uri()}.get(form)
    folder, start = tmp_path / "case", str(file) if form == "start" else ""
    first = reader(folder, said, start)
    assert first.named_files.files == (file,)
    assert reader(folder, said, start).model_digest == first.model_digest
    file.write_text("2.5\n")
    second = reader(folder, said, start)
    assert second.model_digest != first.model_digest
    assert second.digest != first.digest
    if form in ("file", "folder"):
        assert answer(second) == 2.5
    if form == "folder":
        (tables / "other.txt").write_text("1\n")
        assert reader(folder, said).model_digest != second.model_digest


@pytest.mark.parametrize(
    ("said", "why"),
    [
        ("$WEATHER/table.txt", "environment"),
        ("~/table.txt", "home folder"),
        ("%DATA%/table.txt", "environment"),
        ("tables/table.txt", "relative"),
        ("table.txt", "relative"),
        ("/dev/zero", "cannot be read"),
    ],
)
def test_what_cannot_be_followed_is_said_with_the_reason(tmp_path: Path, said: str, why: str) -> None:
    named = reader(tmp_path, said).named_files
    assert not named.files
    assert why in named.unknown["file"]


@pytest.mark.parametrize("said", ["NoName", "Dassl", "y = a + b", "modelica://Library/table.txt", "", None])
def test_a_text_that_is_no_path_names_nothing(tmp_path: Path, said: str | None) -> None:
    named = reader(tmp_path, said).named_files
    assert not named.files
    assert not named.unknown


def test_a_pipe_in_a_folder_is_not_waited_for(tmp_path: Path) -> None:
    tables = tmp_path / "tables"
    tables.mkdir()
    (tables / "table.txt").write_text("1\n")
    os.mkfifo(tables / "pipe")
    assert reader(tmp_path / "case", tables).named_files.files == (tables / "table.txt",)
