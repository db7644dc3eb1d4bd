"""The whole job on the real FMU and the shipped measurement: the real command on small sizes."""

import io
import json
import re
import shlex
import shutil
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands_shown_for_tests import WHY_NOT, give_what_commands_name, lines_shown
from mlflow_store_for_tests import give_store
from project_for_tests import REPOSITORY, add_case

import studies
from simulation.case import load_case
from simulation.measurement import Measurement
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.screen import DifferentialEvolution
from studies.calibration.two_phase import calibrate_two_phase
from studies.cli import main
from studies.exports.written_file import decoders_of
from studies.paths import ProjectPaths, find_project
from studies.profile import PROFILE_FOLDER
from studies.project import read_project
from studies.surrogate_model import SurrogateModel
from studies.tracking.quiet_mlflow import connect
from studies.tracking.runs import RunStore, load_surrogate

pytestmark = pytest.mark.slow

LABEL = "office-quick"
# All five sizes with 8 trials each take minutes; README's first command runs them.
SIZES, N_TRIALS = (32, 64), 5
N_DEFAULTS = 3  # stores, layers, modes
SHORTER = {
    "n_base = 256": "n_base = 16",
    "n_startup_trials = 3": "n_startup_trials = 2",
    "[tuning]\n": "[tuning]\nmax_epochs = 100\nbaseline = false\n",
    "maxiter = 200": "maxiter = 60",
    "max_calls = 300": "max_calls = 40",
}
COMMAND = ("run", "--json", "--trials", str(N_TRIALS))
PAGES = (
    "how-to/load-model.md",
    "mlflow.md",
    "how-to/weights.md",
    "how-to/own-trials.md",
)  # the last adds a trial
THETA = """
import pandas as pd
from studies import load_case

space = load_case("office").parameter_space
theta = pd.DataFrame([space.from_unit([0.5] * len(space.names))], columns=space.names)
"""
# Best MSE by brute force on the FMU (fmus/office/case.toml); the paper usually ends at 1.17 times the best.
BEST_MSE, FACTOR = 0.01052, 1.17


@dataclass(frozen=True)
class Done:
    """A finished `studies run`: its project, and its JSON."""

    project: Path
    document: dict[str, Any]

    def stage(self, name: str) -> dict[str, Any]:
        return next(stage for stage in self.document["stages"] if stage["stage"] == name)

    @property
    def calibrations(self) -> list[dict[str, Any]]:
        return [stage for stage in self.document["stages"] if stage["stage"].startswith("calibrate")]


@pytest.fixture(scope="module")
def profiles(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped profiles; `quick` has fewer simulations, short trainings and early proposals."""
    folder = shutil.copytree(PROFILE_FOLDER, tmp_path_factory.mktemp("short") / "profiles")
    quick = (folder / "quick.toml").read_text(encoding="utf-8")
    for shipped, short in SHORTER.items():
        assert shipped in quick
        quick = quick.replace(shipped, short)
    (folder / "quick.toml").write_text(quick, encoding="utf-8")
    return folder


@pytest.fixture(autouse=True)
def _short(profiles: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.profile.PROFILE_FOLDER", profiles)


@pytest.fixture(scope="module")
def first(profiles: Path, tmp_path_factory: pytest.TempPathFactory) -> Done:
    """What a newcomer gets from one command, without the start of its process."""
    root = tmp_path_factory.mktemp("project")
    (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    add_case(root, "office")
    give_store(root)
    words = [*COMMAND, "--profile", str(profiles / "quick.toml"), "--n-train", *map(str, SIZES)]
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as out:
        patch.chdir(root)
        assert main(words) == 0
    return Done(root, json.loads(out.getvalue()))


def test_the_error_of_the_surrogate_falls_with_the_training_set(first: Done) -> None:
    for metric in ("test/mae", "test/p90"):
        errors = [calibration["screening"]["errors"][metric] for calibration in first.calibrations]
        assert errors == sorted(errors, reverse=True)


def test_the_office_is_calibrated_close_to_the_best_known_error(first: Done) -> None:
    errors = [calibration["mse"] for calibration in first.calibrations]
    # One size may end in the second basin, whose best error is 0.0128.
    assert np.median(errors) <= FACTOR * BEST_MSE
    assert min(errors) >= 0.999 * BEST_MSE


def test_python_finds_what_the_command_has_made_and_does_nothing_twice(
    first: Done, profiles: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(first.project)
    chosen: dict[str, Any] = {"profile": str(profiles / "quick.toml"), "trials": N_TRIALS}
    ran = studies.run(n_train=SIZES, **chosen)
    said = capsys.readouterr().err
    for stage in ("sensitivity", "tune", "calibrate-n0032", "calibrate-n0064", "report"):
        assert f"{stage}: finished before" in said
    sizes = studies.tune(n_train=SIZES, **chosen).sizes
    assert list(sizes.index) == list(SIZES)
    assert (sizes["n_trials"] == N_TRIALS).all()
    assert {"n_latent", "n_hidden", "beta"} <= set(sizes.loc[32, "params"])
    for one in first.calibrations:
        again = studies.calibrate(profile=chosen["profile"], n_train=one["n_train"])
        assert (again.mse, again.theta["value"].to_dict()) == (one["mse"], one["theta"])
        assert again.calls == one["ledger"]["total_calls"] >= one["n_train"] + 640
    assert ran.mse == min(one["mse"] for one in first.calibrations)
    assert ran.trajectories.columns.tolist() == [("TAir", "measured"), ("TAir", "calibrated")]


def test_the_sampler_proposes_what_is_neither_a_default_nor_the_best_of_a_smaller_size(first: Done) -> None:
    for study in first.stage("tune")["studies"]:
        assert study["n_trials"] == N_TRIALS
        assert study["n_complete"] + study["n_pruned"] == N_TRIALS
        # The last trial of a larger size has the best settings of the smaller one.
        assert study["n_proposed"] == N_TRIALS - N_DEFAULTS - (study["n_train"] > SIZES[0])


def test_known_parameters_are_found_again_up_to_what_they_do(first: Done) -> None:
    case = load_case(first.project / "fmus" / "office")
    (run_id,) = (one["run_id"] for one in first.stage("tune")["studies"] if one["n_train"] == 64)
    surrogate = load_surrogate(RunStore(ProjectPaths(first.project)), run_id)
    space = case.parameter_space
    truth = space.from_unit(np.random.default_rng(5).uniform(0.3, 0.7, (1, space.n_parameters)))
    with case.open_model() as office:
        exact = office.simulate(truth)
        result = calibrate_two_phase(
            SurrogateModel(surrogate, space, exact.output_names, exact.time),
            office,
            Measurement.on_grid(exact.time, exact.y[0], exact.output_names, np.array([0.5])),
            screening=DifferentialEvolution(margin=0.2),
            polishing=LeastSquaresTRF(max_calls=300),
            seed=0,
            n_train=64,
        )
    # The data do not determine each parameter, but the temperature to well below a sensor's noise (0.05 K).
    assert result.polish.mse < 0.02**2
    assert result.history.calls_to(0.05**2) is not None


def test_a_pruned_trial_is_made_again_as_far_as_it_came(
    first: Done, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("STUDIES_ROOT", str(first.project))
    client = connect(ProjectPaths(first.project).tracking_uri)
    experiment = client.get_experiment_by_name(LABEL)
    assert experiment is not None
    pruned = client.search_runs([experiment.experiment_id], "tags.pruned = 'True'")[0].info.run_id
    capsys.readouterr()
    assert main(["reproduce", pruned, "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)["numbers"]}
    assert rows["curve/validation_mae"]["is_equal"]
    # Of its best epoch; the error that chooses is a complete trial's alone.
    assert rows["test/mae"]["is_equal"]
    assert "val/mae" not in rows


def test_the_page_of_values_runs_and_its_answers_are_right(
    first: Done, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("onnxruntime", reason="pip install -e '.[onnx]'")
    monkeypatch.chdir(first.project)
    names: dict[str, Any] = {}
    page = (REPOSITORY / "docs" / "how-to" / "values.md").read_text("utf-8")
    for kind, block in re.findall(r"^```(\w+)\n(.*?)^```$", page, re.M | re.S):
        if kind == "python":
            exec(block, names)
        else:
            assert [main(line.split()[1:]) for line in block.splitlines()] == [0] * block.count("\n")
    found = [one for one in read_project(find_project(None)).studies if not one.spec.is_baseline]
    complete = [one.best for one in found if one.best]
    layers = [best for best in complete if decoders_of(best) == {"layers"}]
    best = min(layers, key=lambda one: one.metrics["val/mae"])
    case = studies.load_case("office")
    assert [name for name, _ in json.loads(names["about"]["parameters"])] == list(case.parameter_space.names)
    np.testing.assert_array_equal(json.loads(names["about"]["time_s"]), case.measurement.time)
    expected = load_surrogate(RunStore(ProjectPaths(first.project)), best.run_id).predict(names["theta"])
    # Relative to the largest value, as the page says.
    assert (np.abs(names["y"] - expected) <= 1e-6 * np.abs(expected).max()).all()
    assert names["result"]["TAir"][0] == names["values"]["TAirInit"]


def test_the_commands_of_the_pages_run_in_this_project(
    first: Done,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    lines = lines_shown()
    assert not [reason for reason in WHY_NOT if not any(re.search(reason, line) for line in lines)]
    give_what_commands_name(first.project)
    shutil.copy(first.project / "Room.fmu", tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    failed = {}
    for line in lines:
        if any(re.search(reason, line) for reason in WHY_NOT):
            continue
        words = shlex.split(line)[1:]
        # A case that is written must not be there yet.
        monkeypatch.chdir(tmp_path if words[0] == "new" else first.project)
        if "--write" in words:  # never written over what is there, and two pages write one file
            Path(words[-1]).unlink(missing_ok=True)
        if main(words) != 0:
            failed[line] = capsys.readouterr().err
    assert failed == {}


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::FutureWarning", "ignore::UserWarning")
def test_the_python_of_the_pages_runs_in_this_project(
    first: Done, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pages = [(REPOSITORY / "docs" / page).read_text("utf-8") for page in PAGES]
    blocks = [block for page in pages for block in re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)]
    assert len(blocks) >= 8
    monkeypatch.chdir(first.project)
    names: dict[str, Any] = {}
    exec(THETA + "".join(blocks), names)
    assert names["y"].shape[0] == 1
    assert len(names["best"]) == 2
    assert "n_latent" in capsys.readouterr().out
