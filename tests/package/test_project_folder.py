"""The project is the folder one stands in: its marker, its paths, and the embedded cases."""

import os
import platform
from pathlib import Path

import pytest

from simulation.errors import InputError
from studies import entry
from studies.cli import main
from studies.paths import ProjectPaths, find_case, find_project, mark_project
from studies.words.console import Console

REPOSITORY = Path(__file__).resolve().parents[2]
WALL = REPOSITORY / "fmus" / "wall" / "Wall.fmu"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder, in which no project is declared."""
    monkeypatch.delenv("STUDIES_ROOT", raising=False)
    place = tmp_path / "a" / "b"
    place.mkdir(parents=True)
    monkeypatch.chdir(place)
    return place


def test_without_a_marker_the_working_folder_is_the_project(folder: Path) -> None:
    (folder.parent / "fmus").mkdir()
    (folder.parent / "pyproject.toml").touch()
    assert find_project(None).root == folder


def test_the_nearest_marker_above_makes_the_project(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mark_project(ProjectPaths(folder.parent.parent), Console())
    mark_project(ProjectPaths(folder.parent), Console())
    assert find_project(None).root == folder.parent
    monkeypatch.chdir(folder.parent.parent)
    assert find_project(None).root == folder.parent.parent
    monkeypatch.setenv("STUDIES_ROOT", str(folder))
    assert find_project(None).root == folder.parent


@pytest.mark.parametrize("words", [["status"], ["best"], ["new", str(WALL), "--list"], ["check", "nothing"]])
def test_what_only_reads_or_is_refused_makes_nothing(folder: Path, words: list[str]) -> None:
    main(words)
    assert not list(folder.iterdir())


def test_a_new_case_lands_where_one_stands(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", str(WALL)]) == 0
    said = capsys.readouterr()
    assert said.err.startswith(f"project: {folder} (studies.toml made)")
    assert "wrote fmus/wall/case.toml" in said.out
    assert sorted(place.name for place in folder.iterdir()) == ["data", "fmus", "studies.toml"]


@pytest.mark.parametrize(
    "place", ["../x", "fmus/../../x", "/etc/passwd", "~/x", "a\0b", "x" * 5000, "pipe", 3]
)
def test_a_record_leads_nowhere_else(folder: Path, place: object) -> None:
    project = folder / "project"
    project.mkdir()
    (folder / "x").touch()
    os.mkfifo(project / "pipe")
    assert ProjectPaths(project).located(place) is None


def test_a_case_of_the_project_comes_before_an_embedded_one(folder: Path) -> None:
    paths = ProjectPaths(folder)
    assert find_case(paths, "wall") == WALL.parent / "case.toml"
    own = folder / "fmus" / "wall" / "case.toml"
    own.parent.mkdir(parents=True)
    own.touch()
    assert find_case(paths, "wall") == own
    with pytest.raises(InputError, match=r"did you mean 'wall'\? .*fmus: wall; embedded cases: .*thermostat"):
        find_case(paths, "walll")
    own.unlink()
    own.symlink_to(own)  # a link that leads nowhere is the project's, too
    assert find_case(paths, "wall") == own


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("wall", "wall/case.toml"),
        ("office-whitebox-recorded", "office-whitebox-metered/office-whitebox-recorded.toml"),
    ],
)
def test_a_deleted_case_file_is_not_replaced_by_an_embedded_one(
    folder: Path, capsys: pytest.CaptureFixture[str], name: str, place: str
) -> None:
    paths, own = ProjectPaths(folder), folder / "fmus" / place
    assert paths.located(f"fmus/{place}") == find_case(paths, name)
    own.parent.mkdir(parents=True)
    (own.parent / "Own.fmu").touch()
    assert main(["calibrate", name]) == 2
    said = capsys.readouterr().err
    assert f"fmus/{place} is missing from the folder of this case; restore it" in said
    assert said.count("\n") == 1
    assert paths.located(f"fmus/{place}") is None
    # Other embedded cases stay, and data of this one beside what its simulations left.
    assert find_case(paths, "vanderpol").is_file()
    assert paths.located("data/wall/inputs.csv") is not None
    (own.parent / "Own.fmu").unlink()
    own.parent.rmdir()
    assert find_case(paths, name).is_file()


def test_another_machine_gets_one_line_with_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "aarch64")
    assert entry.main(["status"]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "Linux on x86-64 is missing" in said
    assert "on aarch64" in said
