"""A copy of a finished project that a test may damage, and what a test asks of it."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from project_for_tests import Run

from studies.keeping.mlflow_tables import moved_places, read_mlflow, rewrite_places
from studies.paths import ProjectPaths
from studies.tuning.trial_store import StudyEntry, TrialStore, list_studies, open_trials

LABEL = "office-tiny"


def copy_project(finished: Path, root: Path, monkeypatch: pytest.MonkeyPatch) -> ProjectPaths:
    """Copy a project to a place of its own, and tell MLflow of the place."""
    shutil.copytree(finished, root)
    paths = ProjectPaths(root)
    rewrite_places(paths, moved_places(paths, read_mlflow(paths)))
    enter(paths, monkeypatch)
    return paths


def enter(paths: ProjectPaths, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the command line find a project."""
    monkeypatch.setenv("STUDIES_ROOT", str(paths.root))
    monkeypatch.chdir(paths.root)


def the_study(paths: ProjectPaths) -> tuple[StudyEntry, TrialStore]:
    """Return the one study of a project."""
    (entry,) = list_studies(paths)
    return entry, open_trials(paths, entry.name)


def trial_folder(paths: ProjectPaths, index: int) -> Path:
    """Return the folder of a trial."""
    return Path(the_study(paths)[1].place) / f"t{index:03d}"


def bad_findings(studies: Run, *words: str) -> list[tuple[str, str]]:
    """Return what the doctor finds wrong: the store and what it says."""
    answer = studies("doctor", "--json", *words)
    findings = [(f["store"], f["found"]) for f in answer.document["findings"] if f["level"] == "bad"]
    assert answer.code == (1 if findings else 0)
    return findings


def flip(file: Path, at: float = 0.5) -> None:
    """Change one byte of a file."""
    content = bytearray(file.read_bytes())
    content[int(at * len(content))] ^= 0xFF
    file.write_bytes(bytes(content))


def contents(folder: Path) -> dict[str, bytes]:
    """Return all files below a folder but locks and databases, which are touched by whoever opens them."""
    return dict(_files(folder))


def _files(folder: Path) -> Iterator[tuple[str, bytes]]:
    for file in sorted(folder.rglob("*")):
        is_touched = file.suffix in (".lock", ".db") or file.name in (".lock", ".writers", ".merging")
        if file.is_file() and not is_touched:
            yield str(file.relative_to(folder)), file.read_bytes()
