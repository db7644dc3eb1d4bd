"""The command line and the store: what is asked again, what stops a command, what a full disk does."""

import re
from pathlib import Path

import pandas
from project_for_tests import Run, edit, stored_simulations

SIMULATE = ("simulate", "--profile", "smoke", "--json")


def rows_of(project: Path) -> pandas.DataFrame:
    (rows,) = stored_simulations(project).values()
    return rows


def accept(project: Path, low: float, high: float) -> None:
    """Let simulations outside a band count as failed."""
    band = f"accepted = [{low}, {high}]\nuncertainty ="
    edit(project / "fmus" / "office" / "case.toml", ("uncertainty =", band))


def test_failed_simulations_are_asked_again_on_request_alone(project: Path, studies: Run) -> None:
    accept(project, 0.0, 26.0)
    first = studies(*SIMULATE)
    (stage,) = first.document["stages"]
    n_failed = sum(stage["n_failed"].values())
    assert 0 < n_failed < 48
    assert "--retry-failed repeats them" in first.err
    before = rows_of(project)
    assert studies(*SIMULATE).document["stages"][0]["finished_before"]
    again = studies(*SIMULATE, "--retry-failed")
    (retried,) = again.document["stages"]
    assert retried["n_reused"] == 96 - n_failed
    assert {name: retried[name] for name in ("n_failed", "digests")} == {
        name: stage[name] for name in ("n_failed", "digests")
    }
    after = rows_of(project)
    assert set(before["_theta"]) == set(after["_theta"])
    assert (after["_failure"] != "").sum() == (after["_id"] > before["_id"].max()).sum() == n_failed


def test_a_batch_in_which_most_fails_stops_with_one_line_and_keeps_its_rows(
    project: Path, studies: Run
) -> None:
    accept(project, 21.4, 23.6)
    answer = studies(*SIMULATE, "--jobs", "2")
    assert answer.code == 1
    line = answer.err.splitlines()[-1]
    assert line.startswith("studies: error: ")
    assert "simulation.max_failed_share = 0.5" in line
    # Reasons differ by the numbers in them alone.
    reported = re.search(r"the commonest reason \((\d+) of them\): output TAir", line)
    assert reported is not None
    assert int(reported[1]) > 5
    assert "the finished simulations are kept" in line
    assert "Traceback" not in answer.err
    assert answer.document["error"] in line
    assert len(rows_of(project)) >= 20


def test_other_bounds_share_the_store_and_another_output_does_not(project: Path, studies: Run) -> None:
    (stage,) = studies(*SIMULATE).document["stages"]
    case = project / "fmus" / "office" / "case.toml"
    text = case.read_text()
    lower = next(line for line in text.splitlines() if line.startswith("lower"))
    case.write_text(text.replace(lower, f"lower = {0.99 * float(lower.split('=')[1])}", 1))
    (narrower,) = studies(*SIMULATE).document["stages"]
    assert narrower["store"] == stage["store"]
    assert narrower["n_reused"] == 0
    case.write_text(text)
    (again,) = studies(*SIMULATE).document["stages"]
    assert again["n_reused"] == 96
    assert again["digests"] == stage["digests"]
    accept(project, 0.0, 60.0)
    (banded,) = studies(*SIMULATE).document["stages"]
    assert banded["store"] != stage["store"]
