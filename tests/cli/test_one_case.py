"""Stored results are not replaced silently: by another case file of the name, or by a worse calibration."""

import shutil
from pathlib import Path

import pytest
from project_for_tests import Run, copy_of, edit

from studies import embedded

CALIBRATE = ("--max-calls", "8", "--jobs", "1", "-q")
OUTER = ("GOut = 200.0", "GOut = 100.0")


@pytest.fixture
def project(hasty_wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return copy_of(hasty_wall, tmp_path / "project", monkeypatch)


@pytest.fixture
def other(project: Path) -> Path:
    """The wall's case file, copied to another folder and changed, under the same name."""
    folder = shutil.copytree(project / "fmus" / "wall", project.parent / "w2")
    data = ('"../../data/wall"', f'"{project / "data" / "wall"}"')
    return edit(folder / "case.toml", data, OUTER)


def results_in(project: Path) -> dict[str, bytes]:
    return {f.name: f.read_bytes() for f in (project / "mlruns" / "results" / "wall-quick").iterdir()}


def test_another_case_file_of_the_name_is_refused_and_touches_nothing(
    project: Path, studies: Run, other: Path
) -> None:
    before = results_in(project)
    for command in (["calibrate"], ["uncertainty"], ["simulate"], ["calibrate", "--again"]):
        answer = studies(command[0], str(other), *command[1:])
        assert answer.code == 2
        assert answer.err.count("\n") == 1
        for said in (str(other), "fmus/wall/case.toml", 'the name "wall"', "mlruns/results/wall-quick"):
            assert said in answer.err
    assert results_in(project) == before


def test_the_same_case_file_may_be_edited_and_given_in_other_words(project: Path, studies: Run) -> None:
    assert studies("calibrate", "fmus/wall/../wall/case.toml", *CALIBRATE).code == 0
    before = results_in(project)
    edit(project / "fmus" / "wall" / "case.toml", OUTER)
    assert studies("calibrate", "wall", *CALIBRATE).code == 0
    assert results_in(project)["calibrate-adaptive.json"] != before["calibrate-adaptive.json"]


@pytest.mark.parametrize("is_kept", [True, False], ids=["renamed", "removed"])
def test_a_name_that_was_given_away_is_free(
    project: Path, studies: Run, other: Path, is_kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(embedded, "EMBEDDED", project / "nowhere")  # there the wall keeps its name
    first = project / "fmus" / "wall" / "case.toml"
    if is_kept:
        edit(first, ('name = "wall"', 'name = "first-wall"'))
    else:
        first.unlink()
    assert "wall-quick has no calibration" in studies("uncertainty", str(other)).err
