"""The best surrogate: found again anywhere, refused when damaged, registered under an alias."""

import json
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tuning_checks import ignore

from simulation.errors import InputError
from simulation.store.row_set import RowSet
from studies.paths import ProjectPaths
from studies.search_ranges import SearchRanges
from studies.tracking.mlflow_registry import model_name
from studies.tracking.mlflow_tracker import MlflowTracker
from studies.tracking.tracker import NullTracker, Tracker
from studies.tuning.champion import (
    ChampionInfo,
    champion_lock,
    crown,
    load_champion,
    read_champion,
    restore_champion,
    write_champion,
)
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import best_record, read_records, trial_name
from studies.tuning.trial_store import open_trials
from studies.tuning.trial_worker import run_study
from studies.tuning.tune import tune

MakeSpec = Callable[..., StudySpec]
CASE = "c" * 64


@pytest.fixture(scope="module")
def original(make_spec: MakeSpec, tmp_path_factory: pytest.TempPathFactory) -> tuple[StudySpec, Path, Path]:
    """A study, the folder of its trials, and the folder of its champion."""
    paths = ProjectPaths(tmp_path_factory.mktemp("crowned"))
    mlruns = paths.mlruns
    spec = make_spec()
    run_study(spec, paths=paths, n_trials=3, emit=ignore)
    folder = mlruns / "champions" / "n0016"
    write_best(spec, spec.folder(mlruns), folder)
    return spec, spec.folder(mlruns), folder


@pytest.fixture
def champion(original: tuple[StudySpec, Path, Path], tmp_path: Path) -> Path:
    """A copy of the champion at another path."""
    return Path(shutil.copytree(original[2], tmp_path / "elsewhere" / "n0016"))


def write_best(spec: StudySpec, study_folder: Path, folder: Path) -> bool:
    best = best_record(read_records(study_folder))
    assert best is not None
    return write_champion(spec, best, study_folder=study_folder, folder=folder, run_id="run")


def test_champion_predicts_the_same_at_any_path(
    original: tuple[StudySpec, Path, Path], champion: Path
) -> None:
    spec, _, folder = original
    theta = RowSet.load(spec.test_file).theta
    first, info = load_champion(folder, case_digest=CASE, device="cpu")
    second, copied = load_champion(champion, case_digest=CASE, device="cpu")
    assert info == copied
    np.testing.assert_array_equal(first.predict(theta), second.predict(theta))


def test_champion_knows_where_it_comes_from(original: tuple[StudySpec, Path, Path]) -> None:
    spec, study_folder, folder = original
    best = best_record(read_records(study_folder))
    assert best is not None
    info = read_champion(folder)
    assert isinstance(info, ChampionInfo)
    assert (info.study, info.index, info.seed, info.metrics) == (
        spec.name,
        best.index,
        best.seed,
        best.metrics,
    )
    assert info.parameter_names == spec.parameter_space.names
    assert info.upper == tuple(spec.parameter_space.upper)
    assert info.digests["train"] == spec.train_digest
    assert info.note == "A toy."
    assert json.loads(json.dumps(info.to_dict()))["label"] == "toy-small"


def test_the_same_champion_is_not_written_again(original: tuple[StudySpec, Path, Path]) -> None:
    spec, study_folder, folder = original
    before = (folder / "champion.json").stat().st_mtime_ns
    assert not write_best(spec, study_folder, folder)
    assert (folder / "champion.json").stat().st_mtime_ns == before


def test_missing_champion_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no champion in .*n0064; train one with `studies tune`"):
        load_champion(tmp_path / "n0064")


@pytest.mark.parametrize("name", ["weights.npz", "surrogate.json"])
def test_damaged_or_missing_file_is_one_line(champion: Path, name: str) -> None:
    content = (champion / name).read_bytes()
    (champion / name).write_bytes(content[:-20] + b"x" * 20)
    with pytest.raises(InputError, match=rf"{name} is damaged"):
        load_champion(champion)
    (champion / name).unlink()
    with pytest.raises(InputError, match=rf"has no {name}"):
        load_champion(champion)


@pytest.mark.parametrize("content", ["{", "[]", '{"schema": 1}', '{"schema": 7}'])
def test_unreadable_record_is_one_line(champion: Path, content: str) -> None:
    (champion / "champion.json").write_text(content)
    with pytest.raises(InputError, match=r"champion.json (is damaged|has schema 7)") as caught:
        load_champion(champion)
    assert "\n" not in str(caught.value)


def test_a_champion_is_replaced_by_one_command_at_a_time(
    original: tuple[StudySpec, Path, Path], tmp_path: Path
) -> None:
    spec, study_folder, folder = original
    paths = ProjectPaths(Path(shutil.copytree(folder.parents[2], tmp_path / "project")))
    best = best_record(read_records(study_folder))
    assert best is not None
    other = threading.Thread(target=crown, args=(paths, spec, best))
    with champion_lock(paths, spec.label, spec.n_train):
        other.start()
        other.join(0.5)
        assert other.is_alive()
    other.join(60.0)
    assert read_champion(paths.champion(spec.label, spec.n_train)).index == best.index


def test_a_better_trial_of_another_command_is_crowned(
    original: tuple[StudySpec, Path, Path], tmp_path: Path
) -> None:
    spec, _, folder = original
    paths = ProjectPaths(Path(shutil.copytree(folder.parents[2], tmp_path / "project")))
    trials = open_trials(paths, spec)

    class Meanwhile(NullTracker):
        """Another command finds a better trial while this one looks for the run of the best."""

        def trial_run_id(self, spec: StudySpec, key: str) -> str:
            best = best_record(trials.records())
            if best is not None and best.index < 3:
                better = {"val/mae": 0.5 * best.metrics["val/mae"]}
                place = spec.folder(paths.mlruns)
                trials.write(
                    replace(best, index=3, metrics=best.metrics | better), trials.history(best.index)
                )
                shutil.move(place / trial_name(best.index) / "surrogate", place / trial_name(3))
            return ""

    tune([spec], paths=paths, n_trials=3, n_jobs=1, tracker=Meanwhile())
    assert read_champion(paths.champion(spec.label, spec.n_train)).index == 3


def test_weights_that_are_gone_are_one_line(original: tuple[StudySpec, Path, Path], tmp_path: Path) -> None:
    spec, _, folder = original
    paths = ProjectPaths(Path(shutil.copytree(folder.parents[2], tmp_path / "project")))
    for weights in spec.folder(paths.mlruns).glob("*/surrogate"):
        shutil.rmtree(weights)
    with pytest.raises(InputError, match=r"the weights of .*/t00\d are gone; type: studies doctor --repair"):
        tune([spec], paths=paths, n_trials=3, n_jobs=1)


def test_champion_of_other_physics_is_refused(champion: Path) -> None:
    with pytest.raises(InputError, match="trained for other physics"):
        load_champion(champion, case_digest="d" * 64)


def test_registered_champion_has_the_alias_and_one_version(
    tracker: MlflowTracker, original: tuple[StudySpec, Path, Path]
) -> None:
    spec, _, folder = original
    tracker.start_study(spec, n_trials=3)
    tracker.register_champion(spec, folder)
    tracker.register_champion(spec, folder)
    name = model_name("toy-small", 16)
    assert name == "toy-small-n0016"
    assert len(tracker.client.search_model_versions(f"name = '{name}'")) == 1
    version = tracker.client.get_model_version_by_alias(name, "champion")
    assert version.tags["case_sha256"] == CASE


def test_a_registered_model_tells_the_settings_that_were_tuned(
    tracker: MlflowTracker, original: tuple[StudySpec, Path, Path]
) -> None:
    spec, _, folder = original
    spec = replace(spec, search=SearchRanges(n_layers=(2, 3)))
    tracker.start_study(spec, n_trials=3)
    tracker.register_champion(spec, folder)
    version = tracker.client.get_model_version_by_alias("toy-small-n0016", "champion")
    info = read_champion(folder)
    assert version.description.startswith(f"Trial {info.index} of {info.study}. n_layers ")
    assert "beta" not in version.description


def test_new_champion_leaves_the_old_one_as_previous(
    tracker: MlflowTracker, original: tuple[StudySpec, Path, Path], champion: Path
) -> None:
    spec, _, folder = original
    tracker.start_study(spec, n_trials=3)
    tracker.register_champion(spec, folder)
    changed = replace(read_champion(champion), index=77)
    (champion / "champion.json").write_text(json.dumps(changed.to_dict()))
    tracker.register_champion(spec, champion)
    name = model_name("toy-small", 16)
    assert tracker.client.get_model_version_by_alias(name, "champion").tags["trial"] == "77"
    assert int(tracker.client.get_model_version_by_alias(name, "previous").version) == 1


def test_champion_comes_back_from_the_registry(
    tracker: MlflowTracker, original: tuple[StudySpec, Path, Path], tmp_path: Path
) -> None:
    spec, _, folder = original
    tracker.start_study(spec, n_trials=3)
    tracker.register_champion(spec, folder)
    paths = ProjectPaths(tmp_path / "restored")

    def restore(n_train: int, source: Tracker) -> bool:
        return restore_champion(
            paths, "toy-small", n_train, lambda scratch: source.fetch_champion("toy-small", n_train, scratch)
        )

    assert restore(16, tracker)
    assert load_champion(paths.champion("toy-small", 16), case_digest=CASE)[1] == read_champion(folder)
    assert not restore(32, tracker)
    assert not restore(64, NullTracker())
    assert [file.name for file in paths.champions("toy-small").iterdir()] == ["n0016"]


def test_champion_comes_back_from_the_registry_of_a_moved_project(
    tracker: MlflowTracker, original: tuple[StudySpec, Path, Path], project: ProjectPaths, tmp_path: Path
) -> None:
    spec, _, folder = original
    tracker.start_study(spec, n_trials=3)
    tracker.register_champion(spec, folder)
    moved = ProjectPaths(tmp_path / "moved")
    shutil.copytree(project.mlruns, moved.mlruns)
    project.artifacts.rename(tmp_path / "out-of-reach")
    there = MlflowTracker(moved)
    assert restore_champion(
        moved, "toy-small", 16, lambda scratch: there.fetch_champion("toy-small", 16, scratch)
    )
    restored = moved.champion("toy-small", 16)
    assert load_champion(restored, case_digest=CASE)[1] == read_champion(folder)


def test_registered_champion_loads_where_this_project_is_not(
    tracker: MlflowTracker, original: tuple[StudySpec, Path, Path], project: ProjectPaths, tmp_path: Path
) -> None:
    spec, _, folder = original
    tracker.start_study(spec, n_trials=3)
    tracker.register_champion(spec, folder)
    theta = RowSet.load(spec.test_file).theta[:3]
    np.save(tmp_path / "theta.npy", theta)
    stranger = f"""
import sys
assert not any((__import__("pathlib").Path(entry) / "pelsvae").is_dir() for entry in sys.path if entry)
sys.meta_path[:] = [finder for finder in sys.meta_path if "editable" not in str(finder).lower()]
import mlflow, numpy as np, pandas as pd
mlflow.set_tracking_uri({project.tracking_uri!r})
model = mlflow.pyfunc.load_model("models:/toy-small-n0016@champion")
columns = [column.name for column in model.metadata.signature.inputs]
assert list(model.input_example.columns) == columns
np.save("y.npy", model.predict(pd.DataFrame(np.load("theta.npy"), columns=columns)))
import pelsvae
print(pelsvae.__file__)
"""
    command = [sys.executable, "-I", "-c", stranger]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert str(project.artifacts) in done.stdout
    surrogate, info = load_champion(folder, device="cpu")
    assert info.parameter_names == spec.parameter_space.names
    np.testing.assert_allclose(np.load(tmp_path / "y.npy"), surrogate.predict(theta), rtol=1e-6)
    pickles = (".pkl", ".pickle", ".pt", ".pt2", ".pth", ".joblib")
    files = [file for file in project.artifacts.rglob("champion/**/*") if file.is_file()]
    assert {"MLmodel", "weights.npz", "surrogate.json"} <= {file.name for file in files}
    assert not [file.name for file in files if file.suffix in pickles]
    with np.load(next(file for file in files if file.name == "weights.npz"), allow_pickle=False) as weights:
        assert all(weights[name].dtype != object for name in weights.files)
