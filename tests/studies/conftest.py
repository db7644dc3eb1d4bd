"""Small studies on toy models, and an MLflow database that is made once and copied."""

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from simulation.design import uniform_design
from simulation.store.row_set import RowSet
from simulation.store.store import SimulationStore
from simulation.toy import ToyRC
from simulation.trajectories import Trajectories
from studies.paths import ProjectPaths
from studies.search_ranges import SearchRanges
from studies.tracking.tracker import Tracker
from studies.tuning.study_spec import StudySpec

SMALL_SEARCH = SearchRanges(n_latent=(2, 8), n_hidden=(8, 32), beta=(1.0, 1000.0), learning_rate=(1e-3, 1e-2))
SMALL_TRAINING = {"max_epochs": 20, "validate_every": 1, "patience": 20, "device": "cpu", "n_threads": 1}


@pytest.fixture(scope="session")
def toy_data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with train, validation and test set of a two-parameter RC network, and their simulations."""
    folder = tmp_path_factory.mktemp("toy-data")
    model = ToyRC()
    for seed, (name, n) in enumerate({"train": 32, "validation": 24, "test": 24}.items()):
        store_set(model.simulate(uniform_design(model.parameter_space, n, seed)), folder / f"{name}.npz")
    return folder


def store_set(rows: Trajectories, file: Path) -> None:
    """Store rows beside a file, and write the set to it."""
    with SimulationStore(
        file.parent / "simulations",
        model_digest="toy",
        parameter_names=rows.parameter_names,
        output_names=rows.output_names,
        time=rows.time,
    ) as store:
        store.append(rows.take(~store.find(rows.theta)))
        RowSet(rows.theta, store.folder, file).save()


@pytest.fixture(scope="session")
def make_spec(toy_data: Path) -> Callable[..., StudySpec]:
    """Make a study on the toy data; settings may be changed by name."""
    model = ToyRC()

    def make(n_train: int = 16, **changes: Any) -> StudySpec:
        spec = StudySpec.from_files(
            train_file=toy_data / "train.npz",
            validation_file=toy_data / "validation.npz",
            test_file=toy_data / "test.npz",
            n_train=n_train,
            parameter_space=model.parameter_space,
            label="toy-small",
            case_name="toy",
            case_digest="c" * 64,
            fmu_sha256="f" * 64,
            output_unit="K",
            output_scales=(1.0,),
            variant="refined",
            overrides=SMALL_TRAINING,
            search=SMALL_SEARCH,
            seed=5,
            note="A toy.",
        )
        return replace(spec, **changes)

    return make


@pytest.fixture
def project(tmp_path: Path) -> ProjectPaths:
    """An empty project."""
    (tmp_path / "fmus").mkdir()
    return ProjectPaths(tmp_path)


@pytest.fixture(scope="session")
def empty_database(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An MLflow database with its schema and nothing in it, made by two processes at the same moment."""
    paths = ProjectPaths(tmp_path_factory.mktemp("mlflow-template"))
    script = (
        "import sys; from pathlib import Path; from studies.paths import ProjectPaths\n"
        "from studies.tracking.mlflow_tracker import MlflowTracker\n"
        "MlflowTracker(ProjectPaths(Path(sys.argv[1])))"
    )
    command = [sys.executable, "-c", script, str(paths.root)]
    both = [subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)]
    errors = [process.communicate(timeout=240)[1] for process in both]
    assert [process.returncode for process in both] == [0, 0], errors
    return paths.tracking_database


@pytest.fixture
def tracker(project: ProjectPaths, empty_database: Path) -> Tracker:
    """An MLflow tracker on a database of its own."""
    from studies.tracking.mlflow_tracker import MlflowTracker

    project.mlruns.mkdir()
    shutil.copy(empty_database, project.tracking_database)
    return MlflowTracker(project)
