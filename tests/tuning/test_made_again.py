"""`studies reproduce` of trials on a case: complete, pruned, and after the case has changed."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from mlflow_store_for_tests import give_store
from toy_study_for_tests import ROOT, runs_of

from studies.cli import main
from studies.paths import ProjectPaths

PROFILE = """\
schema = 1
name = "tiny"
[data]
n_train = [16]
n_validation = 16
n_test = 16
[tuning]
n_trials = 4
max_epochs = 100  # validated every 20
patience = 100
baseline = false
sampler = { name = "TPESampler", n_startup_trials = 2 }
pruner = { name = "PercentilePruner", percentile = 1.0, n_startup_trials = 1, n_warmup_steps = 3 }
enqueue = [{ learning_rate = 1e-7 }]
[tuning.search]
learning_rate = { kind = "float", low = 1e-7, high = 0.01, log = true }
n_latent = { kind = "int", low = 2, high = 8 }
n_hidden = { kind = "int", low = 8, high = 16 }
beta = { kind = "float", low = 10.0, high = 100.0, log = true }
"""
LABEL = "wall-tiny"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> ProjectPaths:
    """A project with a tuned wall."""
    root = tmp_path_factory.mktemp("wall") / "project"
    for folder in ("fmus/wall", "data/wall"):
        shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("generated"))
    give_store(root)
    (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    (root / "tiny.toml").write_text(PROFILE, encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STUDIES_ROOT", str(root))
        patch.chdir(root)
        assert main(["tune", "wall", "--profile", "tiny.toml", "--jobs", "2", "--quiet"]) == 0
    return ProjectPaths(root)


@pytest.fixture
def here(made: ProjectPaths, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ProjectPaths:
    """That project at another place, as a test may spoil it."""
    root = tmp_path / "elsewhere"
    shutil.copytree(made.root, root)
    monkeypatch.setenv("STUDIES_ROOT", str(root))
    monkeypatch.chdir(root)
    return ProjectPaths(root)


def reproduced(run_id: str, capsys: pytest.CaptureFixture[str]) -> dict[str, Any]:
    capsys.readouterr()
    code = main(["reproduce", run_id, "--jobs", "1", "--json"])
    answer = capsys.readouterr()
    assert code == 0, answer.out + answer.err
    found: dict[str, Any] = json.loads(answer.out)
    return found


def trial_run(paths: ProjectPaths, state: str) -> str:
    runs = runs_of(paths, LABEL, role="trial", trial_state=state)
    assert runs, f"no trial is {state}"
    return str(runs[-1].info.run_id)


def test_a_pruned_trial_is_made_again_as_far_as_it_went(
    here: ProjectPaths, capsys: pytest.CaptureFixture[str]
) -> None:
    document = reproduced(trial_run(here, "pruned"), capsys)
    assert document["equal"]
    names = {row["name"] for row in document["numbers"]}
    assert "curve/validation_mae" in names
    assert "val/mae" not in names


def test_simulations_that_are_gone_are_made_again(
    here: ProjectPaths, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.rmtree(here.data / "wall" / "generated")
    assert reproduced(trial_run(here, "complete"), capsys)["equal"]
