"""`studies calibrate`: from the case alone, resumed after any call, refused in one line."""

import re
import shutil
import signal
import sys
from pathlib import Path

import pytest
from mlflow_store_for_tests import give_store
from project_for_tests import Run, add_case, edit, interrupt, stored_result, stored_simulations

BEST_KNOWN = 0.01052
N_BEFORE_THE_END = 3
WALL = Path("fmus", "wall", "case.toml")
N_SHORT = 12
ADAPTIVE = ("calibrate", "office", "--jobs", "1")
# Of the wall, which is calibrated faster; state equations would take half of these.
SHORT = ("calibrate", "wall", "--jobs", "1", "--no-state-equations", "--max-calls", str(N_SHORT))


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with office, wall, the recording that the references belong to and an empty MLflow store."""
    root = tmp_path / "project"
    for name in ("office", "wall"):
        add_case(root, name)
    (root / "studies.toml").write_text("schema = 1\n", encoding="utf-8")
    give_store(root)
    monkeypatch.chdir(root)
    return root


def n_stored(project: Path, case: str = "office") -> int:
    """Return the rows of the fuller store: each row lies in one with its states and in one without."""
    return max(map(len, stored_simulations(project, case).values()), default=0)


def test_it_calibrates_the_office_from_nothing_and_is_on_the_page(project: Path, studies: Run) -> None:
    answer = studies(*ADAPTIVE, "--window", "0-10", "--max-calls", "100", "--json")
    stage = answer.stage
    assert stage["mse"] <= 1.3 * BEST_KNOWN
    calls = stage["ledger"]
    assert calls["n_adaptive"] == calls["total_calls"] == stage["n_simulated"] == n_stored(project) <= 100
    assert answer.document["method"] == "adaptive"
    assert answer.document["calls_to_target"]["0.0123"] <= calls["n_adaptive"] <= 8
    command = (*ADAPTIVE, "--window", "0-10")
    shown = studies(*command)
    assert "finished before" in shown.err
    assert f"after {calls['n_adaptive']} model calls" in shown.out
    assert f"Converged: {stage['stop_reason']}" in shown.out
    assert "qIntOcc" in shown.out
    left_open = stage["determined_by_data"]["open"]
    assert {"rExt1", "rExt2", "cExt1"} <= {*left_open}
    assert "qIntOcc" not in left_open
    assert shown.out.count("not determined: ±") == len(left_open)
    assert f"The data do not determine {len(left_open)} of 14 parameters" in " ".join(shown.out.split())
    page = studies("report", "--window", "0-10", "--json")
    assert page.code == 0, page.err
    index = project / page.document["stages"][0]["index"]
    assert index.parent.name == "office-quick"  # the window is the case's own
    text = index.read_text(encoding="utf-8")
    drawn = (
        "<h3>Measured and calibrated: MSE",
        "<h3>Best MSE over model calls",
        "Parameters, calibrated adapt",
    )
    for words in (*drawn, "studies calibrate office --max-calls 100 --window 0-10 --jobs 1"):
        assert words in text


def test_killed_at_any_call_it_goes_on_and_simulates_nothing_twice(
    project: Path, studies: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    undisturbed = shutil.copytree(project, tmp_path / "undisturbed")
    words = (sys.executable, "-m", "studies", *SHORT)
    interrupt(words, project, signal.SIGKILL, lambda *_: n_stored(project, "wall") >= N_BEFORE_THE_END)
    n_before = n_stored(project, "wall")
    assert 1 < n_before < N_SHORT
    resumed = studies(*SHORT, "--json").stage
    assert resumed["n_simulated"] == N_SHORT - n_before
    assert n_stored(project, "wall") == N_SHORT
    monkeypatch.chdir(undisturbed)
    assert studies(*SHORT).code == 0
    assert stored_result(undisturbed) == stored_result(project)


def test_it_stops_at_its_target_and_asks_rows_side_by_side(project: Path, studies: Run) -> None:
    arguments = (*ADAPTIVE[:-1], "2", "--parallel", "4", "--target", "0.1", "--seed", "1")
    answer = studies(*arguments)
    assert answer.code == 0, answer.err
    assert "Converged: the target is reached" in answer.out
    assert "better minimum" not in answer.out
    stage = studies(*arguments, "--json").stage
    assert stage["mse"] <= 0.1
    assert stage["n_rounds"] == stage["ledger"]["n_adaptive"] / 4


@pytest.mark.slow
def test_a_large_error_repeats_what_the_check_found_of_the_step(project: Path, studies: Run) -> None:
    precise = ("uncertainty = 0.05", "uncertainty = 0.01")
    edit(project / WALL, precise, ("communication_step_s = 60 ", "communication_step_s = 600 "))
    lacks = "the model misses an effect"
    unexamined = " ".join(studies("calibrate", "wall", "--jobs", "1", "--max-calls", "20").out.split())
    assert f"{lacks}, or outputs lag behind inputs by a part of the communication step" in unexamined
    assert studies("check", "wall", "--profile", "quick", "-q").code == 0
    examined = " ".join(studies("calibrate", "wall", "--jobs", "1", "--max-calls", "20").out.split())
    found = r"studies check found that half the communication step \(300 s\) changes QRoom by \d+\.?\d* W"
    assert re.search(found, examined), examined
    assert "lower communication_step_s in the case file" in examined


@pytest.mark.slow
def test_failed_simulations_are_reported(project: Path, studies: Run) -> None:
    edit(project / WALL, ("accepted = [-50, 100]", "accepted = [7, 22]"))
    wall = ("calibrate", "wall", "--jobs", "2", "--max-calls", "12")
    answer = studies(*wall)
    assert answer.code == 0, answer.err
    (line,) = [line for line in answer.err.splitlines() if "failed" in line]
    stored = stored_simulations(project, "wall").values()
    reasons = [reason for rows in stored for reason in rows["_failure"] if reason]
    assert line.startswith(f"studies: {len(reasons)} simulation")
    assert "failed, the first one: output" in line
    asked = studies(*wall, "--retry-failed", "--json").stage
    assert not asked["finished_before"]
    # A row beyond its band is one whose states are stored: to ask it again would add nothing.
    assert (asked["n_simulated"], asked["n_failed"]) == (0, len(reasons))
    without = (*wall, "--no-state-equations")
    first = studies(*without, "--json").stage
    n_failed, n_calls = first["n_failed"], first["ledger"]["total_calls"]
    assert f"{n_calls} of {n_calls} simulations reused" in studies(*without, "--again").err
    again = studies(*without, "--retry-failed", "--json").stage
    assert again["n_simulated"] == again["n_failed"] == n_failed > 0


@pytest.mark.slow
def test_a_calibration_whose_simulations_mostly_fail_ends_and_says_why(project: Path, studies: Run) -> None:
    case = project / "fmus" / "wall" / "case.toml"
    text = case.read_text().replace("accepted = [-50, 100]", "accepted = [11, 18]")
    case.write_text(text + "\n[simulation]\nmax_failed_share = 0.2\n")
    words = SHORT[:-2]
    answer = studies(*words)
    assert answer.code == 1
    reported = answer.err.splitlines()[-1]
    assert re.match(r"studies: error: \d+ of \d+ simulations failed, more than simulation", reported)
    assert "max_failed_share = 0.2 allows; the commonest reason: output TMasonry" in reported
    assert "the finished simulations are kept; narrow the bounds (studies check wall" in reported
    # Who allows more goes on with them.
    case.write_text(text + "\n[simulation]\nmax_failed_share = 1.0\n")
    n_before = n_stored(project, "wall")
    stage = studies(*words, "--max-calls", str(n_before + 1), "--json").stage
    assert stage["n_simulated"] == 1


def test_a_model_that_cannot_be_simulated_ends_it_early(project: Path, studies: Run) -> None:
    case = project / "fmus" / "office" / "case.toml"
    text = case.read_text().replace("uncertainty = 0.5", "uncertainty = 0.5\naccepted = [20, 30]")
    case.write_text(text.replace('TAirInit = { first_measured = "TAir" }', "TAirInit = 400.0"))
    answer = studies(*ADAPTIVE)
    assert answer.code == 1
    reported = "studies: error: none of 20 simulations succeeded, the first one: output "
    assert answer.err.splitlines()[-1].startswith(reported)
