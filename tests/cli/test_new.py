"""`studies new`: a case file from what an FMU says about itself, right at once, nothing overwritten."""

import tomllib
import zipfile
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from project_for_tests import Run

from simulation.case import load_case
from simulation.case_reading import read_experiments


def make_fmu(file: Path, variables: str, extra: str = "") -> Path:
    """Write an FMU that can be read, not run."""
    description = (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<fmiModelDescription fmiVersion="2.0" modelName="{file.stem}" guid="g">'
        f'<CoSimulation modelIdentifier="model"/>{extra}<ModelVariables>{variables}</ModelVariables>'
        "<ModelStructure/></fmiModelDescription>"
    )
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", description)
        archive.writestr(f"binaries/{fmpy.platform}/model{fmpy.sharedLibraryExtension}", b"")
    return file


def real(name: str, number: int, causality: str, attributes: str = "", description: str = "") -> str:
    variability = "continuous" if causality in ("input", "output") else "fixed"
    return (
        f'<ScalarVariable name="{name}" valueReference="{number}" causality="{causality}" '
        f'variability="{variability}" description="{description}"><Real {attributes}/></ScalarVariable>'
    )


ROOM = "".join(
    [
        real("UA", 1, "parameter", 'start="100" unit="W/K"', "heat loss &quot;UA&quot;"),
        real("wall.k", 2, "parameter", 'start="0.5" min="0.1" max="2"'),
        real("wall.d[1]", 3, "parameter", 'start="0.2"'),
        real("T0", 4, "parameter", 'start="293.15" unit="K"'),
        real("offset", 5, "parameter", 'start="0"'),
        real("_cs_tol", 6, "parameter", 'start="1e-6"'),
        '<ScalarVariable name="n.windows" valueReference="7" causality="parameter" variability="fixed">'
        '<Integer start="3"/></ScalarVariable>',
        '<ScalarVariable name="table" valueReference="8" causality="parameter" variability="fixed">'
        '<String start="a\\b.txt"/></ScalarVariable>',
        real("TAmb", 9, "input", 'start="280" unit="K"'),
        real("T", 10, "output", 'unit="K"'),
        real("Q", 11, "output", 'unit="W"'),
    ]
)


@pytest.fixture
def room(tmp_path: Path) -> Path:
    return make_fmu(
        tmp_path / "My Room.v2.fmu",
        ROOM,
        extra='<DefaultExperiment startTime="0" stopTime="172800" stepSize="900"/>',
    )


def case_of(project: Path, name: str) -> dict[str, Any]:
    return tomllib.loads((project / "fmus" / name / "case.toml").read_text(encoding="utf-8"))


def test_a_new_case_says_what_the_fmu_says(project: Path, studies: Run, room: Path) -> None:
    answer = studies("new", str(room), "--json")
    assert answer.code == 0, answer.err
    case = case_of(project, "my-room-v2")
    assert answer.document["next"] == ["studies check my-room-v2", "studies calibrate my-room-v2"]
    assert case["fmu"] == "My Room.v2.fmu"
    assert (project / "fmus" / "my-room-v2" / "My Room.v2.fmu").read_bytes() == room.read_bytes()
    assert case["interface"] == "co-simulation"
    assert case["time"]["window_d"] == [0, 2]
    assert case["time"]["communication_step_s"] == 900
    # Top level, start value known, not the tool's own.
    assert [table["name"] for table in case["parameters"]] == ["UA", "T0"]
    assert case["parameters"][0]["estimate"] == 100
    assert (case["parameters"][0]["lower"], case["parameters"][0]["upper"]) == (20, 500)
    assert case["parameters"][0]["scale"] == "log"
    assert case["parameters"][0]["description"] == 'heat loss "UA"'
    assert (case["parameters"][1]["lower"], case["parameters"][1]["upper"]) == (283.15, 303.15)
    assert [(table["name"], table["unit"]) for table in case["inputs"]] == [("TAmb", "K")]
    assert [(table["name"], table["unit"]) for table in case["outputs"]] == [("T", "K")]
    data = project / "data" / "my-room-v2"
    assert (data / "inputs.example.csv").read_text().splitlines()[:2] == ["time_s,TAmb", "0,280"]
    assert (data / "measured.example.csv").read_text().splitlines()[0] == "time_s,T"
    readme = (data / "README.md").read_text(encoding="utf-8")
    assert "| | `TAmb` | input | K |" in readme


def test_the_file_obeys_the_schema_and_every_comment_can_be_used(
    project: Path, studies: Run, room: Path
) -> None:
    assert studies("new", str(room)).code == 0
    file = project / "fmus" / "my-room-v2" / "case.toml"
    assert len(read_experiments(file)[0].file.parameters) == 2
    lines = file.read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith("# Further outputs"))
    end = next(i for i, line in enumerate(lines) if line.startswith("[fixed]"))
    further = [line for line in lines[start:end] if not line.startswith("# Further")]
    after = next(i for i, line in enumerate(lines) if line.startswith("[simulation]"))
    fixed = [line for line in lines[end + 1 : after] if "=" in line and "<output>" not in line]
    text = "\n".join(
        [
            *lines[:start],
            *(line.removeprefix("# ") for line in further),
            lines[end],
            *(line.removeprefix("# ") for line in fixed),
            *(line.removeprefix("# ") for line in lines[after:]),
        ]
    )
    file.write_text(text, encoding="utf-8")
    everything = read_experiments(file)[0].file
    assert {table.name for table in everything.outputs} == {"T", "Q"}
    assert {table.name for table in everything.parameters} == {"UA", "T0", "wall.k", "wall.d[1]", "offset"}
    assert everything.fixed["n.windows"] == 3
    assert everything.simulation.max_workers == 2
    assert everything.fixed["table"] == "a\\b.txt"


def test_nothing_is_overwritten(project: Path, studies: Run, room: Path) -> None:
    assert studies("new", str(room)).code == 0
    file = project / "fmus" / "my-room-v2" / "case.toml"
    file.write_text("mine", encoding="utf-8")
    answer = studies("new", str(room))
    assert answer.code == 2
    assert "never overwritten" in answer.err
    assert "fmus/my-room-v2/case.toml" in answer.err
    assert file.read_text(encoding="utf-8") == "mine"
    assert "exists" in studies("new", str(room), "--to", str(file.parent)).err


def test_an_input_can_be_a_parameter(project: Path, studies: Run, room: Path) -> None:
    document = studies("new", str(room), "--parameter", "UA", "TAmb", "--json").document
    assert document["parameters"] == ["UA", "TAmb"]
    assert "TAmb" not in document["inputs"]
    case = case_of(project, "my-room-v2")
    assert [one["name"] for one in case["parameters"]] == ["UA", "TAmb"]
    assert "TAmb" not in [one["name"] for one in case.get("inputs", ())]


def test_a_command_killed_between_any_two_writes_can_be_typed_again(
    project: Path, studies: Run, room: Path
) -> None:
    assert studies("new", str(room)).code == 0
    folder, data = project / "fmus" / "my-room-v2", project / "data" / "my-room-v2"
    made = {file: file.read_bytes() for place in (data, folder) for file in place.iterdir()}
    # The order in which they are written: the case file last.
    order = sorted(made, key=lambda file: (file.name == "case.toml", file.suffix != ".fmu"))
    for n_written in range(len(order)):
        for file in order[n_written:]:
            file.unlink()
        (folder / ".case.toml.0123abcd.tmp").write_text("half of")
        assert studies("new", str(room)).code == 0
        found = {file: file.read_bytes() for place in (data, folder) for file in place.iterdir()}
        assert found == made


@pytest.mark.parametrize(
    ("arguments", "fragments"),
    [
        (["nowhere.fmu"], ["nowhere.fmu", "no such file"]),
        (["{room}", "--output", "Tx"], ["--output Tx", "did you mean T"]),
        (["{room}", "--parameter", "Q"], ["--parameter Q", "output"]),
        (["{room}", "--parameter", "n.windows"], ["n.windows", "Integer", "[fixed]"]),
        (["{bare}"], ["no real output"]),
    ],
)
def test_a_wrong_wish_is_one_line_and_writes_nothing(
    project: Path, studies: Run, room: Path, arguments: list[str], fragments: list[str]
) -> None:
    bare = make_fmu(room.with_name("bare.fmu"), real("k", 1, "parameter", 'start="1"'))
    before = sorted(project.rglob("*"))
    answer = studies("new", *(word.format(room=room, bare=bare) for word in arguments))
    assert answer.code == 2
    (line,) = answer.err.splitlines()
    for fragment in fragments:
        assert fragment in line
    assert sorted(project.rglob("*")) == before


def test_a_switch_follows_a_recording_and_a_text_is_held(project: Path, studies: Run, tmp_path: Path) -> None:
    switch = (
        '<ScalarVariable name="on" valueReference="9" causality="input" variability="discrete">'
        '<Boolean start="true"/></ScalarVariable>'
        '<ScalarVariable name="word" valueReference="10" causality="input" variability="discrete">'
        '<String start="warm"/></ScalarVariable>'
    )
    variables = real("k", 1, "parameter", 'start="1"') + real("y", 2, "output") + switch
    answer = studies("new", str(make_fmu(tmp_path / "Switch.fmu", variables)), "--json")
    assert answer.document["inputs"] == ["on"]
    (on,) = case_of(project, "switch")["inputs"]
    assert (on["unit"], on["interpolation"]) == ("1", "held")
    assert case_of(project, "switch")["fixed"] == {"word": "warm"}
    assert any('word = "warm"' in edit["text"] for edit in answer.document["edit"])
    data = project / "data" / "switch"
    (data / "measured.csv").write_text("time_s,y\n0,1\n86400,2\n", encoding="utf-8")
    assert "0,1" in (data / "inputs.example.csv").read_text(encoding="utf-8")
    (data / "inputs.csv").write_text("time_s,on\n0,true\n43200,false\n86400,0\n", encoding="utf-8")
    case = project / "fmus" / "switch" / "case.toml"
    loaded = load_case(case)
    assert loaded.fixed == {"word": "warm"}
    assert set(loaded.scenario.inputs[:, 0]) == {0.0, 1.0}
    case.write_text(case.read_text(encoding="utf-8").replace("word =", "# word ="), encoding="utf-8")
    answer = studies("check", "switch")
    assert "the FMU's input word has no [[inputs]] entry" in answer.err
    assert "[fixed]" in answer.err


def test_the_list_shows_every_variable_and_writes_nothing(project: Path, studies: Run, room: Path) -> None:
    before = sorted(project.rglob("*"))
    document = studies("new", str(room), "--list", "--json").document
    assert [one["name"] for one in document["outputs"]] == ["T", "Q"]
    assert {one["name"] for one in document["parameters"]} >= {"UA", "wall.k", "n.windows", "_cs_tol"}
    assert "wall.d[1]" in studies("new", str(room), "--list").out
    assert sorted(project.rglob("*")) == before


def test_columns_that_are_there_say_what_is_a_switch_and_how_far_they_scatter(
    project: Path, studies: Run, tmp_path: Path
) -> None:
    variables = real("k", 1, "parameter", 'start="1"') + real("y", 2, "output", 'unit="W"')
    variables += real("valve", 3, "input") + real("outside", 4, "input")
    fmu, data = make_fmu(tmp_path / "Plant.fmu", variables), project / "data" / "plant"
    data.mkdir(parents=True)
    time, rng = 600.0 * np.arange(200), np.random.default_rng(0)
    y = 500.0 + 200.0 * np.sin(time / 2e4) + 3.0 * rng.standard_normal(200)
    rows = np.column_stack([time, y, (time // 7200) % 2, 5.0 + time / 1e5])
    for name, columns in (("measured.csv", [0, 1]), ("inputs.csv", [0, 2, 3])):
        head = ",".join(np.array(["time_s", "y", "valve", "outside"])[columns])
        np.savetxt(data / name, rows[:, columns], delimiter=",", header=head, comments="")
    answer = studies("new", str(fmu), "--json")
    case = case_of(project, "plant")
    assert {one["name"]: one["interpolation"] for one in case["inputs"]} == {
        "valve": "held",
        "outside": "linear",
    }
    assert case["outputs"][0]["uncertainty"] == pytest.approx(3.0, rel=0.3)
    edits = [one["text"] for one in answer.document["edit"]]
    assert sum("interpolation" in text for text in edits) == 2
    assert any("the scatter of the column" in text for text in edits)


def test_columns_that_cannot_be_read_are_left_to_the_check(
    project: Path, studies: Run, tmp_path: Path
) -> None:
    fmu, data = (
        make_fmu(tmp_path / "Plant.fmu", real("k", 1, "parameter", 'start="1"') + real("y", 2, "output")),
        project / "data" / "plant",
    )
    data.mkdir(parents=True)
    (data / "measured.csv").write_text("time_s,y\n0,much\n")
    assert studies("new", str(fmu)).code == 0
    assert case_of(project, "plant")["outputs"][0]["uncertainty"] == 1.0
