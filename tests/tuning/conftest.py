"""Projects with the toy's data sets: with empty stores, and with tuned studies; made once and copied."""

import shutil
from pathlib import Path

import pytest
from forked_for_tests import FORKED, run_worker
from made_once import made_once
from mlflow_store_for_tests import give_store
from toy_study_for_tests import N_TUNED, SPECS, add_sets

from studies.paths import ProjectPaths
from studies.tuning.storage import open_storage
from studies.tuning.tune_studies import tune
from studies.tuning.worker import Worker


@pytest.fixture(scope="session")
def template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in which nothing was tuned yet."""

    def make(root: Path) -> None:
        root.mkdir()
        (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
        add_sets(root)
        give_store(root)
        open_storage(ProjectPaths(root)).engine.dispose()

    return made_once(tmp_path_factory, "template", make)


@pytest.fixture(scope="session")
def tuned(template: Path, tmp_path_factory: pytest.TempPathFactory) -> ProjectPaths:
    """A project with studies of two sizes and the baselines beside them; to be read or copied."""

    def make(root: Path) -> None:
        shutil.copytree(template, root)
        paths, (first, *others) = ProjectPaths(root), SPECS
        tune(SPECS, paths=paths, n_trials=N_TUNED, n_jobs=1, until_s=0.0)
        other = FORKED.Process(target=run_worker, args=(paths, first.name))
        other.start()
        for spec in others:
            Worker(paths, spec.name).run()
        other.join()
        tune(SPECS, paths=paths, n_trials=N_TUNED, n_jobs=1)

    return ProjectPaths(made_once(tmp_path_factory, "tuned", make))


@pytest.fixture
def project(template: Path, tmp_path: Path) -> ProjectPaths:
    """A project of the test's own in which nothing was tuned yet."""
    shutil.copytree(template, tmp_path / "project")
    return ProjectPaths(tmp_path / "project")


@pytest.fixture
def copied(tuned: ProjectPaths, tmp_path: Path) -> ProjectPaths:
    """The project with tuned studies at another place, as a test may change it."""
    shutil.copytree(tuned.root, tmp_path / "copied")
    return ProjectPaths(tmp_path / "copied")
