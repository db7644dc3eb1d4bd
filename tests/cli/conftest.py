"""A small project with the real office FMU and a made-up recording, and the command line in this process."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from made_up_recording import write_csv_files

from studies.cli import main

REPOSITORY = Path(__file__).resolve().parents[2]
OFFICE = REPOSITORY / "fmus" / "office"


class Answer:
    """What a command answered.

    Args:
        code: exit code.
        out: stdout.
        err: stderr.
    """

    def __init__(self, code: int, out: str, err: str) -> None:
        self.code, self.out, self.err = code, out, err

    @property
    def document(self) -> dict[str, Any]:
        content = json.loads(self.out)
        assert isinstance(content, dict)
        return content


Run = Callable[..., Answer]


def make_project(root: Path) -> Path:
    """Lay out a project with the office and a made-up recording of 22 days."""
    folder = root / "fmus" / "office"
    folder.mkdir(parents=True)
    for name in ("Office.fmu", "case.toml"):
        shutil.copy(OFFICE / name, folder / name)
    write_csv_files(root / "data" / "office")
    (root / "pyproject.toml").write_text("", encoding="utf-8")
    return root


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project that the command line finds."""
    root = make_project(tmp_path / "project")
    monkeypatch.setenv("STUDIES_ROOT", str(root))
    monkeypatch.chdir(root)
    return root


@pytest.fixture
def studies(capsys: pytest.CaptureFixture[str]) -> Run:
    """Run a command in this process."""

    def run(*arguments: str) -> Answer:
        capsys.readouterr()
        code = main(arguments)
        captured = capsys.readouterr()
        return Answer(code, captured.out, captured.err)

    return run
