"""The commands as functions: the same numbers as the command line, from a script without a main guard."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mlflow_store_for_tests import give_store

from studies import CalibrationResult, InputError, StageError, calibrate, load_case, run
from studies.cli import main

ROOT = Path(__file__).parents[2]
SCRIPT = """
import sys
sys.path.insert(0, {root!r})
import studies
assert "pandas" not in sys.modules and "numpy" not in sys.modules  # import studies is quick
from studies import calibrate
calibrate("wall", max_calls=30, seed=1)
"""
GUEST = """
import logging, os, sys, threading, warnings
import mlflow, optuna, scipy.special, torch  # which add filters of warnings of their own
from mlflow.tracking import fluent
mlflow.set_tracking_uri("sqlite:///own.db")
mlflow.set_experiment("mine")
optuna.logging.set_verbosity(optuna.logging.INFO)
from studies import calibrate, reproduce
loggers = ["", "alembic", "mlflow", "mlflow.store.db.utils", "optuna", "psycopg"]
def state():
    levels = [logging.getLogger(name).level for name in loggers]
    return mlflow.get_tracking_uri(), fluent._active_experiment_id, dict(os.environ), list(sys.path), levels
with mlflow.start_run() as mine:
    before, filters, seen, is_over = state(), list(warnings.filters), [], threading.Event()
    def watch():
        while not is_over.wait(0.01):
            seen.append(state()[:2])
    watcher = threading.Thread(target=watch)
    watcher.start()
    print("from here on", file=sys.stderr)
    name = calibrate("wall", max_calls=30, seed=1, again=True).name
    assert reproduce(name, jobs=1).is_equal  # in the project's store again
    print("until here", file=sys.stderr)
    is_over.set()
    watcher.join()
    assert state() == before
    # torch adds some of its own while parts of it are imported later on
    assert not [one for one in warnings.filters if one not in filters and "torch" not in str(one)]
    assert {*seen} == {before[:2]}  # not even briefly, for the script may have threads
    assert mlflow.active_run().info.run_id == mine.info.run_id
    mlflow.log_metric("mse", 1.0)
(run,) = mlflow.MlflowClient().search_runs([mlflow.get_experiment_by_name("mine").experiment_id])
assert run.data.metrics == {"mse": 1.0}
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in which a script has calibrated the wall with seed 1."""
    root = tmp_path_factory.mktemp("python") / "project"
    give_store(root)
    (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    (root / "script.py").write_text(SCRIPT.format(root=str(ROOT)), encoding="utf-8")
    command = [sys.executable, "-W", "error", "script.py"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    return root


@pytest.fixture(autouse=True)
def _here(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(project)


@pytest.fixture
def found(project: Path, capsys: pytest.CaptureFixture[str]) -> CalibrationResult:
    result = calibrate("wall", max_calls=30, seed=1)
    assert "finished before" in capsys.readouterr().err
    return result


def test_a_calibration_is_that_of_the_command_line(
    found: CalibrationResult, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["calibrate", "wall", "--max-calls", "30", "--seed", "1", "--json"]) == 0
    (stage,) = json.loads(capsys.readouterr().out)["stages"]
    assert stage["finished_before"]
    assert found.numbers["digest"] == stage["digest"]
    assert found.theta["value"].to_dict() == stage["theta"]
    assert found.mse == stage["mse"]
    assert found.calls == stage["ledger"]["n_adaptive"] > 0


@pytest.mark.slow
def test_mlflow_stays_as_a_script_has_set_it(project: Path) -> None:
    # As a module, for a script may forget the guard of its main part.
    (project / "guest.py").write_text(GUEST, encoding="utf-8")
    command = [sys.executable, "-c", "import guest"]
    done = subprocess.run(command, cwd=project, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    meanwhile = done.stderr.partition("from here on")[2].partition("until here")[0]
    assert "finished in" in meanwhile
    assert not re.search(r" INFO |\[I |Downloading|Warning", meanwhile), meanwhile


def test_the_trajectories_give_the_error_again(found: CalibrationResult) -> None:
    measurement, terms = load_case("wall").measurement, []
    for name, sensor in zip(measurement.output_names, measurement.uncertainty, strict=True):
        difference = found.trajectories[name, "calibrated"] - found.trajectories[name, "measured"]
        assert 0 < difference.count() < len(difference)  # gaps, and times of the other output
        terms.append(np.mean((difference.dropna() * measurement.uncertainty[0] / sensor) ** 2))
    np.testing.assert_allclose(np.mean(terms), found.mse, rtol=1e-9)


def test_a_result_is_drawn_and_shown(found: CalibrationResult) -> None:
    panels = found.plot()
    assert [axes.get_ylabel() for axes in panels] == ["TMasonry [degC]", "QRoom [W]"]
    assert all(len(axes.lines) == 2 for axes in panels)
    page = found._repr_html_()
    assert "wall-quick-seed1/adaptive: MSE 0.0019" in page
    assert f"<td>{found.theta.loc['GIn', 'value']:.6g}</td>" in page
    assert f"Note: {load_case('wall').note}".replace("'", "&#x27;") in page
    assert repr(found).startswith("wall-quick-seed1/adaptive: MSE 0.0019")


def test_keywords_are_words_of_the_command_line() -> None:
    with pytest.raises(InputError, match="has no surrogate of this case for n_train = 32 64"):
        calibrate("wall", n_train=(32, 64), from_stored=False, target=None)
    with pytest.raises(InputError, match=r"^--no-state-equations belongs to --method adaptive"):
        calibrate("wall", n_train=64, state_equations=False)
    with pytest.raises(InputError, match=r"^--from-stored belongs to --method adaptive"):
        calibrate("wall", n_train=64, from_stored=True)


def test_what_is_wrong_is_said_in_a_line() -> None:
    with pytest.raises(InputError, match="there is no case 'wal'; did you mean 'wall'"):
        calibrate("wal")
    with pytest.raises(InputError, match="there is no case 'wal'"):
        load_case("wal")
    with pytest.raises(InputError, match=r"calibrate\(\): max_calls: '-3' is not"):
        calibrate("wall", max_calls=-3)
    with pytest.raises(TypeError, match=r"calibrate\(\) got an unexpected keyword argument 'trials'"):
        calibrate("wall", trials=3)


def test_a_run_with_errors_in_the_case_is_a_stage_that_failed(project: Path) -> None:
    text = (ROOT / "fmus" / "wall" / "case.toml").read_text("utf-8").replace('name = "wall"', 'name = "cold"')
    text = text.replace('"Wall.fmu"', f'"{ROOT}/fmus/wall/Wall.fmu"').replace("../..", str(ROOT))
    (project / "cold.toml").write_text(text.replace("[-50, 100]", "[12.8, 14.2]"), "utf-8")
    with pytest.raises(StageError, match=r"^cold-quick: studies check cold\.toml found errors"):
        run("cold.toml", jobs=2)
