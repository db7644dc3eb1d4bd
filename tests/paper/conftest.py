"""A project with the embedded office, and the command line in this process."""

import io
import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import pytest
from mlflow_store_for_tests import give_store

from studies.cli import main

REPOSITORY = Path(__file__).resolve().parents[2]

TOY = """\
schema = 1
name = "toy"
note = "A toy."
[data]
n_train = [16]
n_validation = 8
n_test = 12
[sensitivity]
n_base = 4
n_resamples = 4
[tuning]
n_trials = 1
variant = "refined"
max_epochs = 4
[tuning.search]
n_latent = [4, 4]
n_hidden = [16, 16]
beta = [10.0, 10.0]
[screening]
popsize = 1
maxiter = 2
[polish]
max_calls = 16
ftol = 1e-3
"""

Reproduce = Callable[..., tuple[int, dict[str, Any]]]


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project of the office and its white box, with a toy profile."""
    root = tmp_path_factory.mktemp("paper") / "project"
    for case, fmu in (("office", "Office.fmu"), ("office-whitebox-metered", "MeteredOffice.fmu")):
        (root / "fmus" / case).mkdir(parents=True)
        for name in (fmu, "case.toml"):
            shutil.copy(REPOSITORY / "fmus" / case / name, root / "fmus" / case / name)
    ignore = shutil.ignore_patterns("generated", "*.png", "*.py")
    shutil.copytree(REPOSITORY / "data" / "office", root / "data" / "office", ignore=ignore)
    (root / "studies.toml").write_text("schema = 1\n")
    (root / "toy.toml").write_text(TOY)
    give_store(root)
    return root


@pytest.fixture(scope="module")
def reproduce(project: Path) -> Iterator[Reproduce]:
    """Run `studies reproduce-paper office` with the toy profile; return exit code and document."""

    def run(*words: str) -> tuple[int, dict[str, Any]]:
        said = io.StringIO()
        with redirect_stdout(said):
            code = main(["reproduce-paper", "office", "--profile", "toy.toml", "--json", "--quiet", *words])
        return code, json.loads(said.getvalue())

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STUDIES_ROOT", str(project))
        patch.chdir(project)
        yield run
