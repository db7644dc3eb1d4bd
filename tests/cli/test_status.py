"""What `studies status` and `studies best` say of studies and calibrations, without a training."""

import fcntl
import os
import pty
import struct
import subprocess
import sys
import termios
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import optuna
import pytest
from optuna.trial import TrialState
from project_for_tests import REPOSITORY, Run, add_case, process_environment
from studies_for_tests import (
    SPACE,
    WALL_S,
    declared,
    declared_baseline,
    ended_trial,
    write_calibration,
    write_study,
)

from simulation.record_file import read_json, write_json
from studies.calibration.ledger import Ledger
from studies.paths import ProjectPaths
from studies.results.provenance import file_digest
from studies.tuning.storage import storage_of
from studies.tuning.stored_trials import stored_trials

OFFICE = REPOSITORY / "fmus" / "office" / "case.toml"


@pytest.fixture
def project(new_project: Path) -> Path:
    """Status needs no store of MLflow."""
    return new_project


def test_an_empty_project_says_what_to_type_first(project: Path, studies: Run) -> None:
    for command in ("status", "best"):
        answer = studies(command)
        assert answer.code == 0
        assert "studies run" in answer.out
        assert len(answer.out.splitlines()) == 1
    assert studies("status", "--json").document["studies"] == []
    assert studies("best", "--json").document["sizes"] == []
    assert not (project / "mlruns").exists()


def test_every_study_has_a_line_and_the_counts_are_those_of_its_trials(project: Path, studies: Run) -> None:
    study = write_study(project, declared("office-quick", 64), n_trials=12, n_planned=20)
    write_study(project, declared("office-quick", 128), n_trials=3)
    (first, second) = studies("status", "--json").document["studies"]
    states = [trial.state for trial in study.get_trials()]
    assert (first["n_complete"], first["n_pruned"], first["n_failed"]) == tuple(
        states.count(state) for state in (TrialState.COMPLETE, TrialState.PRUNED, TrialState.FAIL)
    )
    assert (first["n_planned"], first["n_proposed"], first["n_running"], first["n_waiting"]) == (20, 6, 0, 0)
    assert (first["to_go_s"], second["to_go_s"]) == (8 * WALL_S, 0.0)
    assert (second["n_train"], second["n_planned"], second["unit"]) == (128, 3, "K")
    best = study.best_trial
    assert first["params"] == best.params
    assert first["metrics"]["val/mae"] == best.value
    shown = studies("status").out
    lines = shown.splitlines()
    (of_64,) = (line for line in lines if "office-quick/n0064" in line)
    (of_128,) = (line for line in lines if "office-quick/n0128" in line)
    for words in ("12/20", f"{best.user_attrs['test/mae']:.3f}", f"{best.params['n_latent']}", "8.0 min"):
        assert f" {words} " in f"{of_64} "
    assert {"3/3", "done"} <= set(of_128.split())
    assert {"n_latent", "n_hidden", "beta", "MAE", "P90", "PCA+GP"} <= set(shown.split())


def test_running_and_waiting_trials_are_counted(project: Path, studies: Run) -> None:
    written = write_study(project, declared("office-quick", 64), n_trials=10, n_planned=20)
    study = optuna.load_study(study_name=written.study_name, storage=f"sqlite:///{project}/mlruns/optuna.db")
    running = study.ask(SPACE)
    running.report(0.5, 100)
    study.enqueue_trial({"n_latent": 32})
    (found,) = studies("status", "--json").document["studies"]
    assert (found["n_running"], found["n_waiting"], found["to_go_s"]) == (1, 1, 10 * WALL_S)


def test_trials_are_read_as_optuna_reads_them(project: Path) -> None:
    written = write_study(project, declared("office-quick", 64), n_trials=12)
    write_study(project, declared("office-quick", 128), n_trials=1)
    study = optuna.load_study(study_name=written.study_name, storage=f"sqlite:///{project}/mlruns/optuna.db")
    running = study.ask(SPACE)
    for step, error in enumerate((0.5, float("nan"), float("inf"))):
        running.report(error, step)
    study.tell(study.ask(), float("-inf"))
    running.suggest_categorical("decoder", ["layers", "state-space"])
    study.enqueue_trial({"n_latent": 32}, user_attrs={"why": "a guess"})
    study.ask()
    study.enqueue_trial({"n_latent": 16})
    with storage_of(ProjectPaths(project)) as storage:
        for one in storage.get_all_studies():
            theirs = storage.get_all_trials(one._study_id)
            # Their words show every field and its order; a nan does not equal itself.
            assert [*map(repr, stored_trials(storage, one._study_id))] == [*map(repr, theirs)]


def test_labels_are_chosen_by_case_label_or_pattern(project: Path, studies: Run) -> None:
    for label in ("office-quick", "office-quick-seed1", "office-paper"):
        write_study(project, declared(label, 64), n_trials=1)
    for label, case in (("office-recorded-quick", "office-recorded"), ("wall-quick", "the wall")):
        write_study(project, declared(label, 64, case_name=case), n_trials=1)

    def labels(which: str) -> list[str]:
        return [study["label"] for study in studies("status", which, "--json").document["studies"]]

    assert labels("office") == ["office-paper", "office-quick", "office-quick-seed1"]
    assert labels("office-quick") == ["office-quick"]
    assert labels("office-recorded") == ["office-recorded-quick"]
    assert labels("the wall") == ["wall-quick"]
    assert labels("*-seed?") == ["office-quick-seed1"]
    for command in ("status", "best"):
        answer = studies(command, "ofice-paper")
        assert answer.code == 2
        assert answer.err.count("\n") == 1
        assert "labels: office-paper, office-quick" in answer.err


def test_best_shows_hyperparameters_errors_and_the_baseline_of_the_same_data(
    project: Path, studies: Run
) -> None:
    spec = declared("office-quick", 64)
    study = write_study(project, spec, n_trials=8)
    best, default = study.best_trial, study.get_trials()[0]
    beside = write_study(project, declared_baseline("office-quick", 64), n_trials=1).best_trial
    other_data = {**declared_baseline("office-quick", 64).digests, "test": "9" * 64}
    write_study(project, declared_baseline("office-quick", 64, digests=other_data, seed=7), n_trials=1)
    document = studies("best", "--json").document
    (size,) = document["sizes"]
    assert size["params"] == best.params
    assert (size["mae"], size["p90"]) == (best.user_attrs["test/mae"], best.user_attrs["test/p90"])
    assert size["gain"] == pytest.approx(1 - best.value / default.value)
    assert size["baseline"]["test/mae"] == beside.user_attrs["test/mae"]
    assert size["model_uri"] is None  # nothing was registered yet
    assert "load_model" not in studies("best").out
    study.set_user_attr("closed", 8)  # as versions of before left it
    (size,) = studies("best", "--json").document["sizes"]
    assert size["model_uri"] == "models:/office-quick-n0064@champion"
    study.set_user_attr("versions", {best.user_attrs["mlflow_run_id"]: 3})
    (size,) = studies("best", "--json").document["sizes"]
    assert size["model_uri"] == "models:/office-quick-n0064/3"
    loaded = optuna.load_study(study_name=size["study"], storage=document["optuna_storage"])
    assert loaded.best_trial.number == best.number
    shown = studies("best").out
    (line,) = (line for line in shown.splitlines() if line.split()[:1] == ["64"])
    for value in (best.params["n_latent"], 128, 100, f"{size['mae']:.3f}", f"{size['p90']:.3f}"):
        assert str(value) in line.split()
    assert {"n_latent", "n_hidden", "beta", "MAE", "P90", "PCA+GP"} <= set(shown.split())
    assert f'optuna.load_study(study_name="{spec.name}", storage="sqlite:///' in shown
    (of_status,) = (line for line in studies("status").out.splitlines() if "office-quick/n0064" in line)
    assert f" {beside.user_attrs['test/mae']:.3f} " in of_status


def test_the_configuration_of_least_mean_over_seeds_is_the_best(project: Path, studies: Run) -> None:
    spec = declared("office-quick", 64)
    study = write_study(project, spec, n_trials=0, n_planned=3)
    # The default, a lucky one, and one that is as good with every seed.
    for index, (n_latent, error) in enumerate(((64, 0.4), (16, 0.2), (32, 0.21))):
        study.add_trial(ended_trial(spec, index, error, n_latent=n_latent))
    further = write_study(project, spec.confirmation, n_trials=0)
    for index, (n_latent, error) in enumerate(
        ((64, 0.4), (64, 0.44), (16, 0.3), (16, 0.34), (32, 0.2), (32, 0.22))
    ):
        trial = ended_trial(spec, index, error, n_latent=n_latent)
        trial.user_attrs |= {"proposed_by": "confirmation", "mlflow_run_id": f"{index + 16:032x}"}
        trial.state = TrialState.COMPLETE  # of every index
        trial.value = error
        further.add_trial(trial)
    (size,) = studies("best", "--json").document["sizes"]
    assert size["params"]["n_latent"] == 32
    assert (size["study"], size["metrics"]["val/mae"]) == (spec.confirmation.name, 0.2)
    assert (size["gain"], size["n_seeds"]) == (pytest.approx(0.5), 2)
    assert size["gain_deviation"] == pytest.approx(0.5 * np.hypot(np.sqrt(2e-4) / 0.21, np.sqrt(8e-4) / 0.42))
    assert (size["n_trials"], size["n_planned"]) == (3, 3)
    assert "50 ± 5 %" in studies("best").out
    (of_status,) = studies("status", "--json").document["studies"]
    assert of_status == {name: size[name] for name in of_status} | {"run_id": of_status["run_id"]}


def test_best_shows_the_parameters_of_the_best_calibration(project: Path, studies: Run) -> None:
    for n_train, mse in ((64, 0.04), (128, 0.02)):
        theta = {"UWin": 0.5 + mse, "b": 1.25}
        ledger = Ledger(n_train=64, n_polish=36, n_test=100).to_dict()
        name = f"n{n_train:04d}"
        write_calibration(project, "office-quick", name, case=OFFICE, mse=mse, theta=theta, ledger=ledger)
    (found,) = studies("best", "--json").document["calibrations"]
    assert (found["name"], found["theta"]) == ("office-quick/n0128", {"UWin": 0.52, "b": 1.25})
    lines = [line.split() for line in studies("best", "office-quick").out.splitlines()]
    assert ["UWin", "W/(m2.K)", "0.52"] in lines
    assert ["b", "1.25"] in lines
    shown = studies("best", "office-quick").out
    assert "MSE 0.02000 K², 100 model calls in the paper's count\n" in shown
    assert "0.02000" in studies("status").out


def test_calibrations_without_a_surrogate_have_a_unit_and_each_case_its_best(
    project: Path, studies: Run
) -> None:
    units = {"vanderpol": "V²", "wall": "K²"}
    for k, case in enumerate(units):
        for window, mse in (("", 0.03), ("-0-9", 0.04 + 0.01 * k)):
            file, label = REPOSITORY / "fmus" / case / "case.toml", f"{case}-quick{window}"
            day, theta = f"2026-01-0{1 + len(window)}", {"U": 0.5 + mse}
            write_calibration(project, label, "adaptive", case=file, mse=mse, theta=theta, finished=day)
    found = {one["case"]: one["name"] for one in studies("best", "--json").document["calibrations"]}
    # The one of the latest window: errors on other windows are not comparable.
    assert found == {case: f"{case}-quick-0-9/adaptive" for case in units}
    shown = studies("best").out
    # There is nothing that the paper would count otherwise.
    assert "vanderpol: best calibration: MSE 0.04000 V², 20 model calls\n" in shown
    assert "wall: best calibration: MSE 0.05000 K², 20 model calls\n" in shown
    assert "wall" not in studies("best", "vanderpol").out
    lines = [line for line in studies("status").out.splitlines() if "/adaptive" in line]
    assert len(lines) == 4
    assert all(units[line.split()[0].split("-")[0]] in line for line in lines)


def test_best_shows_results_of_unchanged_files_first_whatever_a_clock_says(
    project: Path, studies: Run
) -> None:
    case = add_case(project)
    write_calibration(project, "wall-quick", "adaptive", case=case, mse=0.05, finished="2026-01-02")
    write_calibration(project, "wall-quick-0-9", "adaptive", case=case, mse=0.01, finished="2031-01-01")
    manifest = project / "mlruns" / "results" / "wall-quick" / "calibrate-adaptive.json"
    place, sha256 = "fmus/wall/case.toml", file_digest(case)
    record = read_json(manifest)
    assert record is not None
    record["provenance"]["files"][place] = sha256
    write_json(manifest, record)
    # A case whose result was made last, of a file that was changed since.
    file = REPOSITORY / "fmus" / "vanderpol" / "case.toml"
    write_calibration(project, "vanderpol-quick", "adaptive", case=file, mse=0.1, finished="2032-01-01")
    found = studies("best", "--json").document["calibrations"]
    assert [(one["name"], one["changed_since"]) for one in found] == [
        ("wall-quick/adaptive", []),
        ("vanderpol-quick/adaptive", ["case.toml"]),
    ]
    # Where none is unchanged, the one of the latest data.
    case.write_text(case.read_text("utf-8") + "# another thought\n", "utf-8")
    assert studies("best", "wall", "--json").document["calibrations"][0]["name"] == "wall-quick-0-9/adaptive"


def test_the_latest_study_is_that_which_was_made_last_whatever_a_clock_says(
    project: Path, studies: Run
) -> None:
    """It may have been made on a machine whose clock is an hour late, or after this one's was set back."""
    first = declared("office-quick", 64)
    last = replace(first, digests=first.digests | {"test": "a" * 64})
    other = declared("office-thorough", 64)
    for hours, spec in ((2, other), (0, first), (-1, last)):
        write_study(project, spec, n_trials=2, clock=timedelta(hours=hours))
    found = studies("best", "--json").document["sizes"]
    assert [one["study"] for one in found] == [last.name, other.name]


def test_status_loads_nothing_that_trains_or_simulates(project: Path) -> None:
    write_study(project, declared("office-quick", 64), n_trials=2)
    program = (
        "import sys\nfrom studies.cli import main\nmain(['status'])\n"
        "heavy = ('torch', 'mlflow', 'pyarrow', 'scipy', 'vl_convert', 'fmpy', 'numba')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    words = [sys.executable, "-c", program]
    done = subprocess.run(
        words,
        capture_output=True,
        text=True,
        check=True,
        env=process_environment(project),
    )
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(("columns", "shown", "left_out"), [(80, "MAE", "trials/h"), (140, "trials/h", "")])
def test_a_terminal_shows_the_columns_that_fit(
    project: Path, columns: int, shown: str, left_out: str
) -> None:
    write_study(project, declared("office-quick", 64), n_trials=2)
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 30, columns, 0, 0))
    # The terminal says its size, not what the tests' own terminal is said to have.
    whole = process_environment(project) | {"TERM": "xterm"}
    environment = {k: v for k, v in whole.items() if k not in ("COLUMNS", "LINES")}
    words = [sys.executable, "-m", "studies", "status"]
    done = subprocess.run(
        words, stdin=theirs, stdout=theirs, stderr=subprocess.PIPE, env=environment, check=True
    )
    os.close(theirs)
    said = os.read(ours, 65536).decode(errors="replace")
    os.close(ours)
    assert done.stderr == b""
    assert "office-quick/n0064" in said
    assert shown in said
    assert not left_out or left_out not in said
