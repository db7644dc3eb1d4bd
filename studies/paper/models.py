"""The surrogates of Fig. 7 and Table 4: the best of each size in Fig. 6, trained once more on other data."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from simulation.errors import InputError
from studies.paper.fig6_sizes import read_trials
from studies.paper.plan import Plan
from studies.paper.result import item_folder
from studies.search_space import SearchParameter, Value
from studies.stages.learn import tune_stage
from studies.stages.pipeline import Study
from studies.stages.simulate import simulate_stage

Settings = dict[str, Value]


@dataclass(frozen=True)
class Chosen:
    """What Fig. 6 chose.

    Args:
        settings: hyperparameters of the best trial by validation error, by training-set size.
        window_d: days on which they were tuned. [d]
    """

    settings: Mapping[int, Settings]
    window_d: tuple[float, float]


def tuned_for_fig6(window_d: tuple[float, float]) -> str:
    """Say where hyperparameters come from."""
    return f"those of the best trial of Fig. 6, tuned on days {window_d[0]:g} to {window_d[1]:g}"


def chosen_settings(plan: Plan) -> Chosen:
    """Return the hyperparameters of the best trial of each of the plan's sizes.

    Raises:
        InputError: there are no trials of a size, or they are those of another form of the surrogate.
    """
    folder, wanted = plan.trials or item_folder(plan.study, "fig6"), plan.study.profile.tuning.surrogate
    origin, sizes = read_trials(folder)
    tunings = {size.n_train: size.networks for size in sizes}
    for n in plan.budget.n_train:
        if n not in tunings:
            raise InputError(f"{folder} holds no trials of n_train = {n}; tune it, or name another --profile")
        if tunings[n].surrogate != wanted:
            raise InputError(
                f"{folder} holds trials of surrogate {tunings[n].surrogate!r}, the profile asks for "
                f"{wanted!r}; name a profile with --profile"
            )
    settings = {n: dict(tunings[n].best.params) for n in plan.budget.n_train}
    return Chosen(settings, origin.window_d)


def settings_inputs(plan: Plan) -> dict[str, Any]:
    """Return what decides the surrogates; trials that are still to come decide nothing yet."""
    try:
        settings = chosen_settings(plan).settings
    except InputError:
        settings = {}
    data, tuning = plan.study.profile.data, plan.study.profile.tuning
    return {
        "n_train": list(plan.budget.n_train),
        "settings": settings,
        "surrogate": [tuning.surrogate, tuning.max_epochs, tuning.patience],
        "sets": [data.n_validation, data.n_test],
    }


def train_again(study: Study, n_train: int, settings: Settings) -> tuple[Study, float]:
    """Simulate a study's sets and train the surrogate of one of its sizes, with all epochs.

    Args:
        study: the study, with all sizes.
        n_train: training-set size.
        settings: hyperparameters.

    Returns:
        The study of these surrogates, with a label and results of its own; the training time [s].
    """
    study = replace(study, label=f"{study.label}-fig6")
    simulated = simulate_stage(study)
    (found,) = tune_stage(_with_settings(study, n_train, settings), simulated).summary["studies"]
    return study, float(found["wall_s"])


def _with_settings(study: Study, n_train: int, settings: Settings) -> Study:
    """Return the study of one size whose only trial has given hyperparameters."""
    profile = study.profile
    search = {name: SearchParameter("categorical", choices=(value,)) for name, value in settings.items()}
    tuning = replace(profile.tuning, n_trials=1, search=search, enqueue=(), baseline=False)
    data = replace(profile.data, n_train=(n_train,))
    return replace(study, profile=replace(profile, data=data, tuning=tuning))
