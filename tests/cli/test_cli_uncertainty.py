"""`studies uncertainty`: on the terminal and the page, resumed after any call, refused in one line."""

import re
import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from project_for_tests import Run, copy_of, stored_result, stored_simulations

from simulation.case import load_case
from studies.cli import main
from studies.paths import ProjectPaths
from studies.reporting.drawing import write_picture
from studies.reporting.figures_calibration import interval_figure
from studies.reporting.sentences import uncertainty_sentences
from studies.reporting.tables import intervals_table
from studies.results.outcome import read_outcome
from studies.results.stage_results import Uncertainty
from studies.tracking.quiet_mlflow import connect

JUDGE = ("uncertainty", "wall", "--max-calls", "34", "--jobs", "1")
JUDGED = "uncertainty-adaptive"
N_DIFFERENCES = 14


@pytest.fixture(scope="module")
def undisturbed(wall_by_search: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, judged without an interruption."""
    root = shutil.copytree(wall_by_search, tmp_path_factory.mktemp("undisturbed") / "project")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        assert main([*JUDGE, "-q"]) == 0
    return root


@pytest.fixture
def project(wall_by_search: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return copy_of(wall_by_search, tmp_path / "project", monkeypatch)


def n_stored(project: Path) -> int:
    return sum(map(len, stored_simulations(project, "wall").values()))


def test_it_says_how_sure_the_calibration_is(
    wall_by_search: Path,
    undisturbed: Path,
    studies: Run,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    project = shutil.copytree(undisturbed, tmp_path / "project")
    monkeypatch.chdir(project)
    n_before = n_stored(wall_by_search)
    stage = studies(*JUDGE, "--json").stage
    assert stage["finished_before"]
    assert set(stage["parameters"]) == {"GIn", "G12", "G23", "C1", "C2", "C3", "T2Start"}
    for one in stage["parameters"].values():
        low, high = one["interval"]
        assert low < one["median"] < high
    assert stage["parameters"]["T2Start"]["known"] == "determined"
    calls = stage["ledger"]
    assert calls["n_differences"] == N_DIFFERENCES
    assert calls["total"] == N_DIFFERENCES + calls["n_taught"] + calls["n_sample"] <= 34
    assert stage["n_simulated"] == calls["total"] == n_stored(project) - n_before
    assert stage["sample"]["n_effective"] <= stage["sample"]["n"] == calls["n_sample"]

    page = studies("report", "wall", "--json")
    assert page.code == 0, page.err
    text = (project / page.document["stages"][0]["index"]).read_text(encoding="utf-8")
    drawn = ("90 % bands of the outputs", "Intervals of the parameters between their bounds")
    assert all(f"<figure><h3>{title}</h3>" in text for title in drawn)
    (table,) = re.findall("<table><caption>90 % intervals of the parameters.*?</table>", text, re.DOTALL)
    assert re.findall("<tr><td>(.*?)</td>", table) == list(stage["parameters"])
    client = connect(ProjectPaths(project).tracking_uri)
    experiment = client.get_experiment_by_name("wall-quick")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id], "tags.role = 'uncertainty'")
    assert (run.info.status, run.info.run_name) == ("FINISHED", "adaptive uncertainty")

    before = stored_result(project, JUDGED)
    again = studies(*JUDGE, "--again")
    n_read = calls["total"] + calls["n_warm_start"]
    assert f"{n_read} of {n_read} simulations reused" in again.err
    shown = re.sub(r"\s+", " ", again.out)
    assert "90 % intervals of the parameters (adaptive)" in shown
    assert "Noise model: " in shown
    assert f"{calls['total']} model calls: {N_DIFFERENCES} differences" in shown
    assert f"{calls['n_warm_start']} simulations stored before taught it, too" in shown
    assert stored_result(project, JUDGED) == before


@pytest.mark.slow
def test_what_a_calibration_that_ended_early_left_over_is_no_noise(project: Path, studies: Run) -> None:
    early = studies("calibrate", "wall", "--jobs", "1", "--target", "0.05", "--no-state-equations", "--again")
    assert early.code == 0, early.err
    stage = studies(*JUDGE, "--json").stage
    # The store holds a better row, from the calibration before.
    assert stage["sample"]["best_mse"] < 0.5 * stage["mse"]
    assert stage["noise"]["deviation"] ** 2 < 0.5 * stage["mse"]


@pytest.mark.parametrize("is_trusted", [True, False])
def test_a_sample_that_is_worth_nothing_gives_no_interval(
    undisturbed: Path, is_trusted: bool, tmp_path: Path
) -> None:
    folder = undisturbed / "mlruns" / "results" / "wall-quick"
    outcome = read_outcome(folder, "uncertainty-adaptive", Uncertainty)
    assert outcome is not None
    sample = replace(outcome.result.sample, is_trusted=is_trusted)
    found = replace(outcome.result, sample=sample)
    said = uncertainty_sentences(found, "K")
    assert ("The data determine" in " ".join(said)) == is_trusted
    assert said[0].startswith("Noise model" if is_trusted else "The sample of")
    assert np.isfinite(found.interval).all() == is_trusted
    box = load_case(undisturbed / "fmus" / "wall").parameter_space
    table = intervals_table(box, found)
    assert [row[-1] == "too few calls" for row in table.rows] == [not is_trusted] * 7
    assert write_picture(interval_figure(box, found), tmp_path / "intervals.png").stat().st_size > 10_000


@pytest.mark.slow
def test_where_rows_are_stored_and_no_result_it_goes_on_and_simulates_nothing_twice(
    undisturbed: Path, studies: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As after a kill; tests/cli/test_cli_adaptive.py kills a command."""
    project = copy_of(undisturbed, tmp_path / "project", monkeypatch)
    whole = stored_result(project, JUDGED)
    (project / "mlruns" / "results" / "wall-quick" / "uncertainty-adaptive.json").unlink()
    for file in project.glob("data/wall/generated/simulations/*.db"):
        with closing(sqlite3.connect(file)) as database, database:
            database.execute("delete from simulations where _id > (select max(_id) from simulations) - 5")
    resumed = studies(*JUDGE, "--json").stage
    assert resumed["n_simulated"] == 5
    assert stored_result(project, JUDGED) == whole


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ("--max-calls", "20"),
            "must be at least 30: 14 simulations for the slopes of 7 parameters, and a sample of 16",
        ),
        (
            ("--method", "paper"),
            "there is adaptive; type: studies calibrate wall --method paper",
        ),
        (
            ("--n-train", "64"),
            "there is adaptive; type: studies calibrate wall --n-train 64",
        ),
        (("--method", "adaptive", "--n-train", "64"), "--n-train names one calibration of --method paper"),
        (("--noise", "pink"), "invalid choice: 'pink'"),
    ],
)
def test_what_cannot_be_done_is_one_line(
    project: Path, studies: Run, arguments: tuple[str, ...], words: str
) -> None:
    answer = studies("uncertainty", "wall", *arguments)
    assert answer.code == 2
    (line,) = answer.err.splitlines()
    assert line.startswith("studies: error: ")
    assert words in line
