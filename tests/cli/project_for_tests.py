"""What the command line's tests share: a small project with the real office FMU, and answers of commands."""

import json
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pandas
import pytest
from made_up_recording import write_csv_files
from mlflow_store_for_tests import give_store

REPOSITORY = Path(__file__).resolve().parents[2]
OFFICE = REPOSITORY / "fmus" / "office"


TINY_PROFILE = """\
schema = 1
name = "tiny"
[data]
n_train = [16]
n_validation = 32
n_test = 32
[tuning]
n_trials = 3
surrogate = "refined"
max_epochs = 10
patience = 10
[tuning.search]
n_latent = { kind = "int", low = 4, high = 8, log = true }
n_hidden = { kind = "int", low = 16, high = 32, log = true }
beta = { kind = "float", low = 10.0, high = 100.0, log = true }
[screening]
popsize = 4
maxiter = 10
[polish]
max_calls = 20
"""


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

    @property
    def stage(self) -> dict[str, Any]:
        """The one stage of a command that went well."""
        assert self.code == 0, self.err
        (stage,) = self.document["stages"]
        assert isinstance(stage, dict)
        return stage


Run = Callable[..., Answer]


def make_calibrated_wall(root: Path, *options: str) -> Path:
    """Make a project with a wall and calibrate it with some options, quietly, in one process."""
    from studies.cli import main

    make_project(root)
    for folder in ("fmus/wall", "data/wall"):
        shutil.copytree(REPOSITORY / folder, root / folder, ignore=shutil.ignore_patterns("generated"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STUDIES_ROOT", str(root))
        assert main(["calibrate", "wall", "--jobs", "1", "-q", *options]) == 0
    return root


def copy_of(template: Path, root: Path, patch: pytest.MonkeyPatch) -> Path:
    """Copy a project and let the command line find the copy."""
    shutil.copytree(template, root)
    patch.setenv("STUDIES_ROOT", str(root))
    patch.chdir(root)
    return root


def stored_simulations(project: Path, case: str = "office") -> dict[str, pandas.DataFrame]:
    """Return the rows of a case's stores, by the name of the file; read as users read them."""
    found = {}
    for file in sorted(project.glob(f"data/{case}/generated/simulations/*.db")):
        with closing(sqlite3.connect(file)) as database:
            found[file.name] = pandas.read_sql("select * from simulations", database)
    return found


def make_project(root: Path, *, with_store: bool = True) -> Path:
    """Lay out a project with the office, a made-up recording of 22 days and perhaps an empty MLflow store."""
    folder = root / "fmus" / "office"
    folder.mkdir(parents=True)
    for name in ("Office.fmu", "case.toml"):
        shutil.copy(OFFICE / name, folder / name)
    write_csv_files(root / "data" / "office")
    (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    if with_store:
        give_store(root)
    return root
