"""Samplers and pruners by their names and arguments, and what the catch-up pruner stops."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import optuna
import pytest
from optuna.trial import FrozenTrial, TrialState, create_trial
from toy_study_for_tests import plain_study, toy_study

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.tuning.sampler import CatchUpPruner, make_pruner, make_sampler
from studies.tuning.tune_studies import tune
from studies.tuning.worker import Worker


def test_a_study_runs_with_another_sampler(project: ProjectPaths) -> None:
    sampler = {"name": "GPSampler", "n_startup_trials": 2}
    spec = toy_study(sampler=sampler, settings=toy_study().settings | {"max_epochs": 2, "patience": 2})
    tune([spec], paths=project, n_trials=4, n_jobs=1, until_s=0.0)
    Worker(project, spec.name).run()
    trials = plain_study(project, spec.name).get_trials()
    assert len({str(trial.params) for trial in trials}) == 4
    # A random draw is no proposal from results.
    proposed = [trial.user_attrs.get("proposed_by") for trial in trials]
    assert proposed == ["default", None, "GPSampler", "GPSampler"]


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"name": "BestSampler"}, r"no sampler 'BestSampler'; it has .*GPSampler.*TPESampler"),
        ({"name": "TPESampler", "n_startups": 3}, r"TPESampler refuses its arguments: .*n_startups"),
        ({"name": "mine:Sampler"}, r"no package 'mine' is installed; type: pip install mine"),
        ({"name": "os:system"}, r"no package 'os' is installed"),
        ({"name": "optuna.samplers:nothing"}, r"'optuna.samplers:nothing' is no sampler"),
        ({"name": "optuna.pruners:NopPruner"}, r"'optuna.pruners:NopPruner' is no sampler"),
        ({"name": "optuna.no_such:Sampler"}, r"optuna.no_such cannot be imported"),
        ({"name": ".:Sampler"}, r"'.:Sampler' is no module:Class"),
    ],
)
def test_a_wrong_sampler_is_refused(declared: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=rf"^tuning\.sampler: (Optuna has )?{message}"):
        make_sampler(declared, 0)


def test_a_sampler_of_an_installed_package_is_taken_and_of_the_working_folder_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = make_sampler({"name": "optuna.samplers:RandomSampler"}, 0)
    assert isinstance(found, optuna.samplers.RandomSampler)
    (tmp_path / "of_a_stranger.py").write_text("raise SystemExit('it was run')\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(InputError, match=r"^tuning\.sampler: no package 'of_a_stranger' is installed"):
        make_sampler({"name": "of_a_stranger:Sampler"}, 0)


@pytest.mark.skipif(find_spec("cmaes") is not None, reason="the optional part is there")
def test_a_sampler_without_its_package_is_refused_before_it_proposes() -> None:
    with pytest.raises(InputError, match=r"CmaEsSampler needs the package cmaes; type: pip install cmaes"):
        make_sampler({"name": "CmaEsSampler"}, 0)


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ({"name": "NoPruner"}, r"no pruner 'NoPruner'; it has CatchUpPruner, .*NopPruner"),
        ({"name": "PatientPruner", "wrapped_pruner": {"name": "No"}, "patience": 2}, r"no pruner 'No'"),
    ],
)
def test_a_wrong_pruner_is_refused(declared: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=rf"^tuning\.pruner: (Optuna has )?{message}"):
        make_pruner(declared)


def a_trial(reports: Mapping[int, float], value: float | None = None) -> FrozenTrial:
    """Return a trial that is complete, or runs where it has no value yet."""
    state = TrialState.RUNNING if value is None else TrialState.COMPLETE
    return create_trial(state=state, value=value, intermediate_values=dict(reports))


def is_stopped(known: list[FrozenTrial], reports: Mapping[int, float], caution: float = 1.5) -> bool:
    study = optuna.create_study()
    study.add_trials(known)
    return CatchUpPruner(caution).prune(study, a_trial(reports))


# Each completed trial lost half of its error after step 10.
KNOWN = [a_trial({5: 4.0, 10: 2.0, 20: 1.2}, 1.0), a_trial({5: 5.0, 10: 3.0, 20: 1.6}, 1.5)]


def test_nothing_is_stopped_without_completed_trials_or_reports() -> None:
    assert not is_stopped([], {10: 1e9})
    assert not is_stopped([create_trial(state=TrialState.PRUNED, value=1.0)], {10: 1e9})
    assert not is_stopped(KNOWN, {})


def test_a_hopeless_trial_is_stopped_and_a_promising_one_is_not() -> None:
    # 0.5 to the power of 1 + 1.5 / 2 of its error may be left, so 3.364 would become the best one's 1.0.
    assert is_stopped(KNOWN, {10: 3.37})
    assert not is_stopped(KNOWN, {10: 3.36})
    assert not is_stopped(KNOWN, {10: 1.9})


def test_one_completed_trial_is_enough_to_stop_what_is_far_behind() -> None:
    assert is_stopped(KNOWN[:1], {10: 6.0})
    assert not is_stopped(KNOWN[:1], {10: 5.0})
