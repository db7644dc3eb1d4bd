"""Fig. 6: every trial's error over the training-set size, and how much hyperparameters matter at each."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from studies.paper.fig6_shown import shown
from studies.paper.fig6_sizes import SizeTrials, Tuning, read_trials, tuning_of
from studies.paper.plan import FAITHFUL_PROFILE, FAITHFUL_TRAINING_S, SIMULATIONS_PER_S, Plan
from studies.paper.result import ItemResult, item_folder
from studies.paper.size_files import Origin, origin_of, write_sizes
from studies.paper.tuned import Tuned, tune_sizes
from studies.profile import Profile, load_profile
from studies.row_set import RowSet
from studies.stages.pipeline import Study
from studies.stages.simulate import set_files
from studies.stages.tuned_trials import tuned_by_size


def inputs(plan: Plan) -> dict[str, Any]:
    """Return all that decides the result."""
    budget = plan.budget
    beside = {"trials": budget.faithful_trials, "tuning": _tuning(load_profile(FAITHFUL_PROFILE))}
    return {
        "n_train": list(budget.n_train),
        "trials": budget.trials,
        "tuning": _tuning(plan.study.profile),
        "faithful": beside if budget.faithful_trials else None,
    }


def estimate_s(plan: Plan) -> float:
    """Estimate how long it takes from nothing. [s]."""
    budget = plan.budget
    n_rows = max(budget.n_train) + 640
    faithful_s = 0.0
    if budget.faithful_trials:
        faithful_s = plan.training_s(plan.faithful_sizes, budget.faithful_trials, FAITHFUL_TRAINING_S)
    return plan.training_s(budget.n_train, budget.trials) + faithful_s + n_rows / SIMULATIONS_PER_S


def run(plan: Plan) -> ItemResult:
    """Tune every size on the window of Fig. 6, the faithful form beside it, and compare all trials."""
    budget = plan.budget
    tuned = tune_sizes(plan.hyperparameter_study(), budget.trials)
    found = [(tuned, budget.trials)]
    if budget.faithful_trials:
        faithful = tune_sizes(plan.faithful_study(), budget.faithful_trials)
        found.append((faithful, budget.faithful_trials))
    origin, sizes = collected(plan, *(one for one, _ in found))
    result = shown(origin, sizes)
    files = write_sizes(item_folder(plan.study, "fig6"), origin, sizes)
    commands = tuple(command for one, trials in found for command in one.commands(trials))
    return replace(result, files=files, uses=commands)


def drawn_from(folder: Path) -> tuple[Origin, ItemResult]:
    """Return the same from the files of an earlier run, without simulations and trainings.

    Raises:
        InputError: the files cannot be read, or do not belong together.
    """
    origin, sizes = read_trials(folder)
    return origin, shown(origin, sizes)


def collected(plan: Plan, tuned: Tuned, faithful: Tuned | None = None) -> tuple[Origin, list[SizeTrials]]:
    """Return all trials of all sizes that have a complete one, the smallest size first.

    Args:
        plan: what is repeated.
        tuned: the surrogate of the profile.
        faithful: the form of the paper, None without.
    """
    study = tuned.study
    origin = origin_of(plan, study, "fig6")
    networks = _tunings(study)
    beside = {} if faithful is None else _tunings(faithful.study)
    pca_gp = _tunings(study, baseline=True)
    sizes = [
        SizeTrials(n, mean, networks[n], beside.get(n), pca_gp.get(n))
        for n, mean in _mean_predictor(tuned).items()
        if n in networks
    ]
    return origin, sizes


def _tunings(study: Study, *, baseline: bool = False) -> dict[int, Tuning]:
    found = {n: tuning_of(one) for n, one in tuned_by_size(study, baseline=baseline).items()}
    return {n: one for n, one in found.items() if one is not None}


def _tuning(profile: Profile) -> dict[str, Any]:
    tuning: dict[str, Any] = profile.to_dict()["tuning"]
    return {key: value for key, value in tuning.items() if key != "n_trials"}


def _mean_predictor(tuned: Tuned) -> dict[int, float]:
    """Return the test error of predicting the training set's mean trajectory, by size. [output's unit]."""
    files = set_files(tuned.study, tuned.simulated.summary)
    scales = tuned.study.case.measurement.error_scales
    train, test = RowSet.load(files["train"]).read().y, RowSet.load(files["test"]).read().y
    test = test[np.isfinite(test).all(axis=(1, 2))]
    return {
        n: float(np.mean(np.abs(np.nanmean(train[:n], axis=0) - test) * scales))
        for n in sorted(tuned.study.profile.data.n_train)
    }
