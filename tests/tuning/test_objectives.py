"""A user's function as an objective: its trials have all that trials of surrogates have."""

import os
import random
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mlflow_store_for_tests import give_store
from objectives_for_tests import bowl, pair, picky, wrong
from optuna.trial import FrozenTrial, TrialState, create_trial
from toy_study_for_tests import plain_study, runs_of, states, workers_of

from simulation.errors import InputError
from studies import ObjectiveResult, best, reproduce, status, tune
from studies.cli import main
from studies.paths import ProjectPaths
from studies.results.objective import ObjectiveDeclaration
from studies.tracking.runs import RunStore
from studies.tuning.attempts import make_study, places, run_again
from studies.tuning.objectives import ObjectiveTrials, imported
from studies.tuning.storage import storage_of
from studies.tuning.worker import Worker

N_KILLS, N_TRIALS = 10, 24


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    give_store(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(Path(__file__).parent))
    return tmp_path


def declared(**changes: object) -> ObjectiveDeclaration:
    given = {"label": "a", "sampler": {"name": "RandomSampler"}, "pruner": {"name": "NopPruner"}, "seed": 3}
    return ObjectiveDeclaration(**{**given, "values": ("value",), **changes})


def test_trials_of_a_function_are_shown_while_they_run(root: Path) -> None:
    paths, spec = ProjectPaths(root), declared(pruner={"name": "MedianPruner", "n_startup_trials": 1})
    with storage_of(paths) as storage:
        make_study(storage, spec, n_trials=5)
    Worker(paths, spec.name, objective=ObjectiveTrials(bowl)).run()
    assert_mlflow_agrees(paths, spec.name, "a")
    (known,) = status().project.objectives
    assert known.count("complete", "pruned") == known.n_ended == 5


def assert_mlflow_agrees(paths: ProjectPaths, name: str, label: str) -> list[FrozenTrial]:
    """Check that the run of each trial has its parameters, its curve and its end, and return the trials."""
    trials, runs = plain_study(paths, name).get_trials(), runs_of(paths, label, role="trial")
    assert {*states(trials)} == {"COMPLETE", "PRUNED"}
    assert [run.data.tags["trial_state"].upper() for run in runs] == states(trials)
    for run, trial in zip(runs, trials, strict=True):
        assert run.info.status == "FINISHED"
        assert run.data.params["x"] == str(trial.params["x"])
        curve = RunStore(paths).client.get_metric_history(run.info.run_id, "curve/value")
        assert {one.step: one.value for one in curve} == trial.intermediate_values
        assert run.data.metrics["bad name_"] == trial.params["x"]
        assert (run.data.metrics.get("value") == trial.value) == (trial.state.name == "COMPLETE")
    return trials


@pytest.mark.slow
def test_a_function_is_tuned_extended_and_made_again(root: Path) -> None:
    (root / "my.toml").write_text(
        "seed = 4\n[tuning]\nn_trials = 5\nenqueue = [{ x = 0.3, kind = 'round' }]\n"
        "pruner = { name = 'MedianPruner', n_startup_trials = 1 }\n"
        "sampler = { name = 'TPESampler', n_startup_trials = 2 }\n"
    )
    result = tune(objective=bowl, name="dish", profile="my.toml")
    assert isinstance(result, ObjectiveResult)
    paths = ProjectPaths(root)
    trials = assert_mlflow_agrees(paths, result.tuned.spec.name, "dish")
    assert len(trials) == 5
    assert trials[0].params == {"x": 0.3, "kind": "round"}
    least = min(t.values[0] for t in trials if t.state.name == "COMPLETE")
    assert result.tuned.best[0].values == [least]
    assert list(result.trials["params.x"]) == [t.params["x"] for t in trials]
    runs, (of_study,) = runs_of(paths, "dish", role="trial"), runs_of(paths, "dish", role="study")
    assert RunStore(paths).has(of_study.info.run_id, "figures")
    # The same command finds all finished; more trials go on.
    again = tune(objective=bowl, name="dish", profile="my.toml", trials=6)
    assert isinstance(again, ObjectiveResult)
    assert [t.values for t in again.tuned.trials[:5]] == [t.values for t in trials]
    assert again.tuned.n_ended == 6
    (known,) = status().project.objectives
    assert known.n_ended == 6
    (shown,) = best("dish").numbers["objectives"]
    assert shown["best"][0]["values"] == {"value": again.tuned.best[0].values[0]}
    pruned = next(run.info.run_id for run in runs if run.data.tags["pruned"] == "True")
    for run_id in (shown["best"][0]["run_id"], pruned):
        rows = reproduce(run_id, objective="objectives_for_tests:bowl")
        assert rows.is_equal, rows.rows
        assert {"curve/value", "loss"} <= {row.name for row in rows.rows}
    with pytest.raises(InputError, match=r"no record says what is run; type: .* --objective objectives_for"):
        reproduce(pruned)


def test_the_command_shows_a_pareto_set_within_constraints(
    root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--objective", "objectives_for_tests:pair", "--values", "cost", "use", "--maximize", "use"]
    assert main(["tune", *words, "--trials", "6", "--parallel", "2"]) == 0
    out = capsys.readouterr().out
    assert "pair: Pareto set of" in out
    assert "use (max.)" in out
    assert main(["status"]) == 0
    assert "6/6" in capsys.readouterr().out
    (found,) = status().project.objectives
    feasible = [one for one in found.trials if one.params["x"] <= 1.5]
    # Of two values that rise together, one of them minimized, no feasible trial is better than another one.
    assert [one.number for one in found.best] == [
        one.number for one in sorted(feasible, key=lambda one: one.params["x"])
    ]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"objective": "nosuch:f"}, r"'nosuch' cannot be imported: ModuleNotFoundError"),
        ({"objective": "objectives_for_tests:f"}, r"'objectives_for_tests:f' is no function"),
        ({"objective": bowl, "n_train": 32}, r"n_train = 32 is of a case"),
        ({"objective": bowl, "case": "room"}, r"case = room is of a case"),
        ({"objective": bowl, "values": ["a", "a"]}, r"values: 'a': give each once, a letter"),
        ({"objective": bowl, "maximize": "b"}, r"maximize: b is none of the values value"),
        ({"objective": lambda trial: 1.0}, r"name: '<lambda>': give each once"),
        ({"objective": bowl, "name": "../x"}, r"name: '../x': give each once"),
        ({"objective": bowl, "profile": "quick.toml"}, r"there is no profile"),
        ({"objective": bowl, "profile": "thorough"}, r"unknown key .*an objective's profile has name"),
        ({"name": "x"}, r"name = x is of an objective"),
    ],
)
def test_wrong_words_are_refused_in_a_line(root: Path, words: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        tune(**words)


def test_what_no_trial_can_use_is_a_failed_trial_with_its_reason(root: Path) -> None:
    paths, spec = ProjectPaths(root), declared()
    with storage_of(paths) as storage:
        make_study(storage, spec, n_trials=5)
    Worker(paths, spec.name, objective=ObjectiveTrials(picky)).run()
    reasons = [one.user_attrs["reason"] for one in plain_study(paths, spec.name).get_trials()]
    assert [one.split(";")[0] for one in reasons] == [
        "it returned 'nan'",
        "it returned 'no'",
        "it returned '[1. 2.]'",
        "it returned 'None'",
        "ZeroDivisionError: float division by zero",
    ]
    with pytest.raises(InputError, match=r"no trial of wrong/\w+ was completed; .*ValueError: no data"):
        tune(objective=wrong, trials=2)
    with pytest.raises(InputError, match="need studies tune --objective MODULE:FUNCTION --name a"):
        Worker(paths, spec.name)


def test_a_trial_that_is_run_again_begins_without_its_constraints(root: Path) -> None:
    paths, spec = ProjectPaths(root), declared(values=("near", "far"))
    with storage_of(paths) as storage:
        study = make_study(storage, spec, n_trials=1)
        study.add_trial(create_trial(state=TrialState.RUNNING, constraints={"x - 1.5": 9.0}))
        run_again(study, study.get_trials()[0])
        study.tell(0, state=TrialState.FAIL)
    Worker(paths, spec.name, objective=ObjectiveTrials(pair)).run()
    (ended,) = places(plain_study(paths, spec.name).get_trials())
    assert ended.constraints == {"x - 1.5": ended.params["x"] - 1.5}


def test_a_function_is_named_by_a_user_alone() -> None:
    assert imported("objectives_for_tests:bowl") is bowl


@pytest.mark.slow
def test_nothing_is_lost_or_doubled_by_kills(root: Path) -> None:
    draw = random.Random(int(os.environ.get("KILLS_SEED", "0")))
    words = ["--objective", "objectives_for_tests:pair", "--values", "cost", "use", "--maximize", "use"]
    command = [sys.executable, "-m", "studies", "tune", *words, "--parallel", "3", "--jobs", "3"]
    paths, n_kills = ProjectPaths(root), 0
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}

    def begun() -> subprocess.Popen[bytes]:
        return subprocess.Popen([*command, "--trials", str(N_TRIALS)], env=environment, cwd=root)

    process = begun()
    while n_kills < N_KILLS and process.poll() is None:
        time.sleep(draw.uniform(0.5, 3.0))
        if process.poll() is None and (workers := workers_of(process.pid)):
            # The command itself now and then: the same command goes on.
            victim = process if draw.random() < 0.2 else draw.choice(workers)
            victim.kill()
            n_kills += 1
            if victim is process:
                process.wait()
                process = begun()
    while process.wait() != 0:
        process = begun()
    (found,) = status().project.objectives
    trials = plain_study(paths, found.spec.name).get_trials()
    assert len(places(trials)) == N_TRIALS
    assert [one.state.name for one in places(trials)] == ["COMPLETE"] * N_TRIALS
    for trial in places(trials):
        assert trial.values == [trial.params["x"] ** 2, trial.params["x"]]
    repeated = {n for one in trials for n in one.system_attrs.get("retry_history", [])}
    assert {one.number for one in trials} - {one.number for one in places(trials)} == repeated
    runs = {run.info.run_id: run for run in runs_of(paths, "pair", role="trial")}
    assert not [one for one in runs.values() if one.info.status == "RUNNING"]
    ended = [runs[trial.user_attrs["mlflow_run_id"]] for trial in places(trials)]
    assert len({one.info.run_id for one in ended}) == N_TRIALS
    assert {one.info.status for one in ended} == {"FINISHED"}
    assert n_kills >= 3, "too few to say something"


def test_the_page_says_what_works(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "own-objective.md").read_text("utf-8")
    error, _, plan = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    (profile,) = re.findall(r"^```toml\n(.*?)^```", page, re.M | re.S)
    (root / "mine.py").write_text(f"{error}\n\n{plan}", "utf-8")
    (root / "my.toml").write_text(profile, "utf-8")
    path = [*sys.path]
    for words in (["mine:error"], ["mine:plan", "--values", "error", "seconds", "--profile", "my.toml"]):
        assert main(["tune", "--objective", *words, "--trials", "3"]) == 0
    sys.path[:] = path
    out = capsys.readouterr().out
    assert "error: best of 3 trials" in out
    assert "plan: Pareto set of" in out
