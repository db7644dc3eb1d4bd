"""A small project with the real office FMU and a made-up recording, and the command line in this process."""

from pathlib import Path

import pytest
from made_once import made_once
from mlflow_store_for_tests import give_store
from project_for_tests import Answer, Run, make_calibrated_wall, make_project

from studies.cli import main


@pytest.fixture
def new_project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project that the command line finds, in which nothing was made yet."""
    root = make_project(tmp_path / "project", with_store=False)
    monkeypatch.chdir(root)
    return root


@pytest.fixture
def project(new_project: Path) -> Path:
    """The same with an empty MLflow store."""
    give_store(new_project)
    return new_project


@pytest.fixture
def studies(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in this process."""

    def run(*arguments: str) -> Answer:
        capsys.readouterr()
        code = main(arguments)
        captured = capsys.readouterr()
        return Answer(code, captured.out, captured.err)

    return run


@pytest.fixture(scope="session")
def hasty_wall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with a wall that was hastily calibrated; to be copied."""
    options = ("--max-calls", "8")
    return made_once(tmp_path_factory, "hasty-wall", lambda root: make_calibrated_wall(root, *options))


@pytest.fixture(scope="session")
def wall_by_search(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with a wall that was searched without state equations, not quite to the end; to be copied."""
    options = ("--no-state-equations", "--max-calls", "18")
    return made_once(tmp_path_factory, "wall-by-search", lambda root: make_calibrated_wall(root, *options))
