"""Names that stand more than once in a model description: refused where they are named, else harmless."""

import re
import shutil
from pathlib import Path

import pytest
from c_fmu_for_tests import write_fmu
from case_for_tests import repack

from simulation import InputError, load_case
from studies.calibration.state_equations.states import watching_states, why_unwatched
from studies.doctor.names import look_at_names

DECAY = Path(__file__).with_name("decay.c")
REPOSITORY = Path(__file__).parents[2]
MORE = (
    '<ScalarVariable name="{name}" valueReference="9" causality="{causality}" variability="{variability}">'
    "<Real/></ScalarVariable>"
)
KINDS = {"parameter": "tunable", "output": "continuous", "local": "continuous"}


def add(folder: Path, name: str, causality: str, n: int = 1) -> None:
    """Add variables to the FMU of a case."""
    variable = MORE.format(name=name, causality=causality, variability=KINDS[causality])
    end = "</ModelVariables>"
    text = DECAY.with_suffix(".xml").read_text().replace(end, n * variable + end)
    write_fmu(folder / "decay.fmu", text, DECAY)


@pytest.mark.parametrize(
    ("name", "causality", "where", "first"),
    [
        ("k", "parameter", r"parameters\[k\]", 0),
        ("y", "output", r"outputs\[y\]", 4),
        ("y", "local", r"outputs\[y\]", 4),
        ("u", "parameter", r"inputs\[u\]", 3),
        ("x0", "parameter", r"fixed\.x0", 1),
    ],
)
def test_a_name_that_the_case_uses_may_not_stand_twice(
    decay_case: Path, name: str, causality: str, where: str, first: int
):
    add(decay_case, name, causality)
    said = f"{name} stands twice in modelDescription.xml, with the value references {first} and 9; give each"
    with pytest.raises(InputError, match=f"^.*case.toml: {where}: decay.fmu: {re.escape(said)}") as error:
        load_case(decay_case)
    assert "\n" not in str(error.value)


def test_nor_three_times(decay_case: Path):
    add(decay_case, "k", "parameter", n=2)
    with pytest.raises(InputError, match=r"k stands 3 times in .* the value references 0, 9 and 9"):
        load_case(decay_case)


def test_another_name_is_a_warning(decay_case: Path):
    assert list(look_at_names(load_case(decay_case))) == []
    add(decay_case, "spare", "local", n=2)
    (found,) = look_at_names(load_case(decay_case))
    assert (found.level, found.found) == (
        "warn",
        "spare stands twice in modelDescription.xml, with the value references 9 and 9",
    )


@pytest.mark.parametrize("name", ["K", "Y", "U"])
def test_names_that_differ_in_capitals_are_two(decay_case: Path, name: str):
    add(decay_case, name, "local")
    assert list(look_at_names(load_case(decay_case))) == []


@pytest.mark.parametrize(
    ("name", "reason"), [("T1", "T1 stands twice in"), ("der(T2)", "der(T2) stands twice in"), ("spare", "")]
)
def test_states_that_stand_twice_are_not_watched(tmp_path: Path, name: str, reason: str):
    wall = REPOSITORY / "fmus" / "wall"
    more = f'<Float64 name="{name}" causality="local" valueReference="{{}}"/>'.format

    def doubled(members: dict[str, bytes]) -> dict[str, bytes]:
        text = members["modelDescription.xml"].decode()
        more_than_one = more(98) + more(99) + "</ModelVariables>"
        return members | {"modelDescription.xml": text.replace("</ModelVariables>", more_than_one).encode()}

    shutil.copy(wall / "Wall.fmu", tmp_path)
    repack(tmp_path / "Wall.fmu", doubled)
    text = (wall / "case.toml").read_text().replace("../../data/wall", str(REPOSITORY / "data" / "wall"))
    (tmp_path / "case.toml").write_text(text)
    case = load_case(tmp_path)
    assert reason.replace("twice", "3 times") in why_unwatched(case)
    if not reason:
        # Nothing reads what has one name and two references.
        assert "spare" not in watching_states(case).watched


def test_a_new_case_does_not_name_them(decay_case: Path, tmp_path: Path, monkeypatch, capsys):
    from studies.cli import main

    add(decay_case, "k", "parameter")
    monkeypatch.chdir(tmp_path)
    fmu = tmp_path / "twice.fmu"
    shutil.copy(decay_case / "decay.fmu", fmu)
    assert main(["new", str(fmu), "--parameter", "k"]) == 2
    said = "k stands twice in modelDescription.xml, with the value references 0 and 9"
    assert said in capsys.readouterr().err
    assert not (tmp_path / "fmus").exists() or not list((tmp_path / "fmus").glob("twice/*"))
    assert main(["new", str(fmu), "--parameter", "x0"]) == 0
