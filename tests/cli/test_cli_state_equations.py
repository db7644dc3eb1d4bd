"""`studies calibrate` of an FMU that shows its states: what they did says where to simulate next."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from made_once import made_once
from project_for_tests import (
    DAY,
    REPOSITORY,
    Run,
    add_case,
    copy_of,
    make_judged_wall,
    make_project,
    stored_result,
)

from studies.cli import main

WALL = ("calibrate", "wall", "--jobs", "1")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project in which the wall was calibrated by its state equations."""
    root = make_project(tmp_path_factory.mktemp("equations") / "project")
    for name in ("wall", "thermostat"):
        add_case(root, name)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(root)
        # Killed after three simulations, as it were: the next command goes on from there.
        patch.setattr("studies.stages.adaptive_stage.LEAST_CALLS", 1)
        assert main([*WALL, "--max-calls", "3", "--quiet"]) == 0
    return root


@pytest.fixture
def project(made: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(made)
    return made


def test_it_goes_on_from_what_is_stored_and_says_what_the_equations_did(project: Path, studies: Run) -> None:
    answer = studies(*WALL)
    assert answer.code == 0, answer.err
    found = stored_result(project)
    n_calls, learnt = found["ledger"]["total_paper"], found["state_equations"]
    assert n_calls == 5
    assert "3 of 5 simulations reused" in answer.err
    assert learnt["are_believed"]
    assert learnt["n_states"] == 3
    assert learnt["misfit"] < 1e-12
    assert f"learnt, and {learnt['n_calls']} call went where they expect the lowest error" in answer.out
    assert "Converged: by the state equations at most 0.1 % of the error" in answer.out
    manifest = project / "mlruns" / "results" / "wall-quick" / "calibrate-adaptive.json"
    made = json.loads(manifest.read_text(encoding="utf-8"))["provenance"]
    assert made["command"] == "studies calibrate wall --jobs 1"
    page = studies("report", "wall", "--json")
    assert page.code == 0, page.err
    shown = (project / "mlruns" / "reports" / "wall-quick" / "index.html").read_text(encoding="utf-8")
    assert "state equations" in shown


def test_weather_inside_the_fmu_takes_as_few_calls(project: Path, studies: Run) -> None:
    inside = REPOSITORY / "tests" / "benchmarks" / "fewest_calls" / "wall_inside"
    shutil.copytree(inside, project / "fmus" / "wall-inside")
    answer = studies("calibrate", "wall-inside", "--jobs", "1")
    assert answer.code == 0, answer.err
    found = stored_result(project, label="wall-inside-quick")
    equations = found["state_equations"]
    assert found["ledger"]["total_paper"] == 5
    assert equations["are_believed"]
    assert equations["hidden_inputs"] == ["TIn", "TOut"]
    assert "learnt with TIn and TOut of the FMU as inputs, and 1 call went where" in answer.out
    # 34 calls of the search without equations end at 0.006644.
    assert found["mse"] < 0.00665
    assert found["converged"]


def test_where_nothing_can_be_learnt_it_says_so(
    project: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Without its other variables the FMU does not show the position of its switch.
    monkeypatch.setattr("studies.calibration.state_equations.states.MOST_LOCALS", 0)
    answer = studies("calibrate", "thermostat", "--max-calls", "6", "--jobs", "1")
    assert answer.code == 0, answer.err
    assert "State equations of 3 states: not learnt, for no sum of states, inputs" in answer.out
    assert "makes up der(T): the best leaves" in answer.out
    assert not stored_result(project, label="thermostat-quick")["state_equations"]["are_believed"]


def test_who_wants_them_is_learnt_why_there_are_none(
    made: Path, tmp_path: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = copy_of(made, tmp_path / "project", monkeypatch)
    monkeypatch.setattr("studies.calibration.state_equations.states.MOST_STATES", 2)
    answer = studies(*WALL, "--state-equations")
    assert answer.code == 2
    *_, line = answer.err.splitlines()
    assert line.endswith("Wall.fmu: has 3 states, and at most 2 are watched; leave --state-equations away")
    assert studies(*WALL, "--max-calls", "8").code == 0
    assert "state_equations" not in stored_result(project)


@pytest.mark.slow
def test_its_simulations_are_everybodys(
    made: Path, tmp_path: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    project = copy_of(made, tmp_path / "project", monkeypatch)
    assert studies(*WALL).code == 0
    without = (*WALL, "--no-state-equations", "--max-calls", "10")
    # Four of the seven rows of its first design are among the five that were asked with their states.
    assert studies(*without, "--json").stage["n_simulated"] == 10 - 4
    found = stored_result(project)
    assert "state_equations" not in found
    # Six have no states, and teach the equations nothing.
    answer = studies(*WALL, "--from-stored", "--max-calls", "6")
    assert answer.code == 0, answer.err
    known = np.load(project / "mlruns" / "results" / "wall-quick" / "calibrate-adaptive.npz")
    assert f"begins with {len(known['start_theta'])} stored simulations of this model" in answer.err
    assert (~known["start_watched"]).sum() == 6
    assert known["start_watched"].sum() >= 5
    assert stored_result(project)["state_equations"]["are_believed"]
    assert studies("reproduce", "wall-quick/adaptive").code == 0


@pytest.mark.slow
def test_how_sure_it_is_takes_no_more_than_the_sample(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, studies: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged = made_once(tmp_path_factory, "judged-wall", make_judged_wall)
    project = copy_of(judged, tmp_path / "project", monkeypatch)
    judge = ("uncertainty", "wall", *DAY, "--max-calls", "30", "--jobs", "1")
    answer = studies(*judge)
    assert answer.code == 0, answer.err
    found = stored_result(project, "uncertainty-adaptive", "wall-quick-d1-2")
    calls = found["ledger"]
    assert (calls["n_differences"], calls["n_taught"], calls["total"]) == (0, 0, 16)
    assert calls["by_equations"]
    assert found["sample"]["n_effective"] > 8
    learnt = " ".join(answer.out.split())
    assert "(16 model calls; the model's state equations gave the rest)" in learnt
    again = studies(*judge, "--again", "--json")
    assert again.code == 0, again.err
    assert again.document["stages"][0]["n_simulated"] == 0
    assert stored_result(project, "uncertainty-adaptive", "wall-quick-d1-2") == found
