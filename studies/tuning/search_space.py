"""Which hyperparameters are searched, and which a trial tries next: a function of the trials before."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.trial import create_trial

from simulation.errors import InputError
from studies.profile import SearchRanges

N_STARTUP_TRIALS = 5
_POWERS_OF_TWO = ("n_latent", "n_hidden")
_LOGARITHMIC = ("beta", "learning_rate")
_WHOLE = ("n_layers",)

Params = dict[str, float | int]


@dataclass(frozen=True)
class PastTrial:
    """A finished trial as the search sees it.

    Args:
        params: its hyperparameters in search coordinates.
        value: its validation error, None where it failed. [output's unit]
        complete: whether it was trained to its end.
    """

    params: Params
    value: float | None
    complete: bool


def distributions(ranges: SearchRanges) -> dict[str, BaseDistribution]:
    """Return the search coordinates: widths as exponents of two, weights and rates on a logarithmic scale."""
    found: dict[str, BaseDistribution] = {}
    for name in _POWERS_OF_TWO:
        low, high = getattr(ranges, name)
        lowest, highest = math.ceil(math.log2(low)), math.floor(math.log2(high))
        if lowest > highest:
            raise InputError(f"the search range of {name}, {low} to {high}, holds no power of two; widen it")
        found[f"log2_{name}"] = IntDistribution(lowest, highest)
    for name in _LOGARITHMIC:
        if (span := getattr(ranges, name)) is not None:
            found[name] = FloatDistribution(span[0], span[1], log=True)
    for name in _WHOLE:
        if (span := getattr(ranges, name)) is not None:
            found[name] = IntDistribution(span[0], span[1])
    return found


def to_settings(params: Mapping[str, float | int]) -> dict[str, Any]:
    """Translate search coordinates into settings of the surrogate."""
    return {
        (name.removeprefix("log2_")): (2 ** int(value) if name.startswith("log2_") else value)
        for name, value in params.items()
    }


def nearest_params(ranges: SearchRanges, settings: Mapping[str, Any]) -> Params:
    """Translate settings of the surrogate into search coordinates, clipped into the ranges."""
    found: Params = {}
    for name, distribution in distributions(ranges).items():
        value = settings[name.removeprefix("log2_")]
        value = float(np.log2(value)) if name.startswith("log2_") else float(value)
        assert isinstance(distribution, IntDistribution | FloatDistribution)
        value = min(max(value, distribution.low), distribution.high)
        found[name] = round(value) if isinstance(distribution, IntDistribution) else value
    return found


def suggest(
    ranges: SearchRanges, past: Sequence[PastTrial], *, default: Mapping[str, Any], seed: int
) -> Params:
    """Choose the hyperparameters of the next trial.

    The first trial is the variant's own configuration, then follow random draws, then a Gaussian process. The
    process is refitted from the past trials with a seed of its own at every trial, so that an interrupted
    study goes on exactly as an uninterrupted one. A trial that was pruned or failed counts as no better than
    the worst completed one: the process would otherwise not see it and propose it again.

    Args:
        ranges: ranges of the hyperparameters.
        past: all finished trials, in order.
        default: settings of the variant.
        seed: seed of this trial's draw.
    """
    if not past:
        return nearest_params(ranges, default)
    space = distributions(ranges)
    study = _memory_study(seed)
    completed = [trial.value for trial in past if trial.complete and trial.value is not None]
    if completed:
        worst = max(completed)
        for trial in past:
            value = trial.value if trial.complete and trial.value is not None else worst
            study.add_trial(create_trial(params=dict(trial.params), distributions=space, value=value))
    return dict(study.ask(space).params)


def _memory_study(seed: int) -> optuna.Study:
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.GPSampler(seed=seed, n_startup_trials=N_STARTUP_TRIALS)
    return optuna.create_study(direction="minimize", sampler=sampler)


def derived_seed(seed: int, *path: int) -> int:
    """Derive an independent seed from a seed and whole numbers that name its use."""
    return int(np.random.SeedSequence([seed, *path]).generate_state(1)[0])
