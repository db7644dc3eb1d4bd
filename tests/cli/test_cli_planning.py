"""`studies choose`, `studies next` and `studies uncertainty --profiles` on the real FMU."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from project_for_tests import Run, copy_of

from studies import load_case, next_experiment
from studies.paths import ProjectPaths
from studies.tracking.quiet_mlflow import connect

ROOT = Path(__file__).parents[2]
SAME = 0.05
"""Largest difference of an end of a profile from that of the posterior, as a share of the interval: both are
nearly normal here, and 600 particles leave so much by chance."""


@pytest.fixture
def project(hasty_wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return copy_of(hasty_wall, tmp_path / "project", monkeypatch)


def stiff_wall(project: Path) -> None:
    """Put a case beside the wall whose plaster has a fixed capacity that the data contradict."""
    text = (ROOT / "fmus" / "wall" / "case.toml").read_text("utf-8")
    text = re.sub(r'\[\[parameters\]\]\nname = "C1"\n.*?(?=\n\[)', "", text, flags=re.S)
    text = text.replace("[fixed]", "[fixed]\nC1 = 200000.0") if "[fixed]" in text else text
    assert "C1 = 200000.0" in text
    text = text.replace('name = "wall"', 'name = "stiff"', 1)
    text = text.replace('"../../data/wall"', f'"{ROOT / "data" / "wall"}"')
    folder = project / "fmus" / "stiff"
    folder.mkdir(parents=True)
    shutil.copy(ROOT / "fmus" / "wall" / "Wall.fmu", folder)
    (folder / "case.toml").write_text(text, "utf-8")


@pytest.mark.slow
def test_profiles_stand_beside_the_posterior(project: Path, studies: Run) -> None:
    words = ("uncertainty", "wall", "--profiles", "--max-calls", "62", "--jobs", "1")
    answer = studies(*words, "--json")
    assert answer.code == 0, answer.err
    posterior, profiles = answer.document["stages"]
    assert profiles["by_equations"]
    assert profiles["is_confirmed"]
    assert profiles["n_calls"] == 15
    for name, one in profiles["parameters"].items():
        assert one["at_bound"] == [False, False]
        np.testing.assert_allclose(one["rise"], profiles["limit"], rtol=0.05)
        (low, high), ends = one["interval"], posterior["parameters"][name]["interval"]
        assert low < posterior["parameters"][name]["calibrated"] < high
        np.testing.assert_allclose([low, high], ends, atol=SAME * 4.0 * (high - low))
    again = studies(*words, "--json")
    assert all(one["finished_before"] for one in again.document["stages"])
    page = studies("report", "wall", "--json")
    text = (project / page.document["stages"][0]["index"]).read_text("utf-8")
    assert "<figure><h3>Profile likelihoods</h3>" in text
    assert "The profiles are of state equations" in text


def test_the_next_experiment_is_ranked_without_a_simulation_but_one(project: Path, studies: Run) -> None:
    stage = studies("next", "wall", "--vary", "TIn=15:25", "--seed", "0", "--json").stage
    assert stage["n_calls"] == 1
    assert stage["error"] < 0.01
    merits = [one["merit"] for one in stage["candidates"]]
    assert merits == sorted(merits)
    best = stage["candidates"][0]
    # Of a new experiment the masonry begins anew.
    assert best["own"] == ["T2Start"]
    assert all(best["half_widths"][name] <= width * 1.0001 for name, width in stage["half_widths"].items())
    block = (project / stage["block"]).read_text("utf-8")
    assert f'name = "{best["name"]}"' in block
    assert "per_experiment = true" in block
    rows = (project / stage["inputs"]).read_text("utf-8").splitlines()
    assert rows[0] == "time_s,TIn"
    assert {row.split(",")[1] for row in rows[1:]} == {"15", "25"}
    # As its comments say, it makes a case of two experiments.
    shutil.copytree(ROOT / "data" / "wall", project / "own")
    shutil.copy(project / stage["inputs"], project / "own")
    text = (ROOT / "fmus" / "wall" / "case.toml").read_text("utf-8")
    text = re.sub(r"\nvalidation_d[^\n]*", "", text[: text.index("# Where each")])
    text = text.replace('name = "T2Start"', 'name = "T2Start"\nper_experiment = true')
    text = text.replace("../../data/wall", "own").replace(
        "Wall.fmu", str(ROOT / "fmus" / "wall" / "Wall.fmu")
    )
    (project / "two.toml").write_text(f"{text}\n{block}", "utf-8")
    two = load_case(project / "two.toml")
    assert two.parameter_space.names[-2:] == ("T2Start@recorded", f"T2Start@{best['name']}")
    # The same from Python, finished before.
    assert next_experiment("wall", vary=["TIn=15:25"], seed=0).table.index[0] == best["name"]


def test_without_equations_slopes_are_simulated(
    wall_by_search: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, studies: Run
) -> None:
    copy_of(wall_by_search, tmp_path / "project", monkeypatch)
    stage = studies("next", "wall", "--inputs", str(ROOT / "data" / "wall" / "inputs.csv"), "--json").stage
    (one,) = stage["candidates"]
    # Two for each of seven parameters and one, at the calibrated point and for the candidate.
    assert one["n_calls"] == 15
    assert not one["by_equations"]
    assert stage["n_calls"] == 30
    assert stage["error"] is None
    assert one["shrinks_to"] < 1.0


@pytest.mark.parametrize(
    ("words", "line"),
    [
        (
            ("--vary", "TIn=5"),
            "--vary TIn=5: write INPUT=LOW:HIGH in the unit of the case file; inputs: TIn, TOut",
        ),
        (("--vary", "TIn=9:5"), "--vary TIn=9:5: LOW has to be below HIGH"),
        (("--output", "nothing=1"), "--output nothing=1: write NAME=UNCERTAINTY with a variable of Wall.fmu"),
        ((), "no other window and no held-out experiment; give --inputs FILE"),
        (("--criterion", "E"), "invalid choice: 'E'"),
    ],
)
def test_what_cannot_be_planned_is_said_in_a_line(
    project: Path, studies: Run, words: tuple[str, ...], line: str
) -> None:
    answer = studies("next", "wall", *words)
    assert answer.code == 2
    assert line in answer.err
    assert "Traceback" not in answer.err


@pytest.mark.slow
def test_the_structure_that_the_data_contradict_is_not_chosen(project: Path, studies: Run) -> None:
    stiff_wall(project)
    stage = studies("choose", "wall", "stiff", "--max-calls", "30", "--jobs", "1", "--json").stage
    assert stage["chosen"] == "wall"
    whole, stiff = stage["structures"]
    assert whole["probability"] > 0.99
    assert stiff["larger"] == "wall"
    assert stiff["ratio_p"] < 1e-3
    assert stiff["bic"] > whole["bic"]
    assert stiff["left_out_mse"] > whole["left_out_mse"]
    assert whole["by_equations"]
    client = connect(ProjectPaths(project).tracking_uri)
    experiment = client.get_experiment_by_name("wall-quick")
    assert experiment is not None
    runs = client.search_runs([experiment.experiment_id])
    (parent,) = [run for run in runs if run.data.tags["role"] == "choice"]
    assert parent.data.tags["chosen"] == "wall"
    children = [run for run in runs if run.data.tags.get("mlflow.parentRunId") == parent.info.run_id]
    assert len(children) == 2
    page = studies("report", "wall", "--json")
    text = (project / page.document["stages"][0]["index"]).read_text("utf-8")
    assert "Chosen: wall" in text


@pytest.mark.parametrize(
    ("cases", "line"),
    [
        (("wall",), "choose compares cases of different names, two or more; given: wall"),
        (("wall", "thermostat"), "structures are compared on one measurement"),
    ],
)
def test_what_cannot_be_compared_is_said_in_a_line(
    project: Path, studies: Run, cases: tuple[str, ...], line: str
) -> None:
    answer = studies("choose", *cases)
    assert answer.code == 2
    assert line in answer.err
