"""A project with the embedded office, and the command line in this process."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from mlflow_store_for_tests import give_store
from paper_study_for_tests import reproduce_paper
from project_for_tests import add_case

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
surrogate = "refined"
max_epochs = 4
[tuning.search]
n_latent = { kind = "int", low = 4, high = 4, log = true }
n_hidden = { kind = "int", low = 16, high = 16, log = true }
beta = { kind = "float", low = 10.0, high = 10.0, log = true }
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
    """A project of the office, with a toy profile."""
    root = tmp_path_factory.mktemp("paper") / "project"
    add_case(root, "office")
    (root / "studies.toml").write_text("schema = 1\n")
    (root / "toy.toml").write_text(TOY)
    give_store(root)
    return root


@pytest.fixture(scope="module")
def reproduce(project: Path) -> Iterator[Reproduce]:
    """Run `studies reproduce-paper office` with the toy profile; return exit code and document."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(project)
        yield partial(reproduce_paper, "office", "--profile", "toy.toml")
