"""Which hyperparameters are searched, and which a trial tries next: a function of the trials before it."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution, FloatDistribution, IntDistribution
from optuna.trial import TrialState as OptunaState
from optuna.trial import create_trial

from pelsvae.config import SurrogateConfig
from simulation.errors import InputError
from studies.profile import SearchRanges
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord

N_STARTUP_TRIALS = 5
_POWERS_OF_TWO = ("n_latent", "n_hidden")
_LOGARITHMIC = ("beta", "learning_rate")
_WHOLE = ("n_layers",)

Params = dict[str, float | int]


@dataclass(frozen=True)
class Proposal:
    """What a trial tries.

    Args:
        params: its hyperparameters in search coordinates.
        config: all settings of the surrogate.
        seed: seed of its training.
        origin: why these hyperparameters, such as "default", "random" or "gp".
    """

    params: Params
    config: SurrogateConfig
    seed: int
    origin: str


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


def propose(
    spec: StudySpec, index: int, finished: Sequence[TrialRecord], pending: Sequence[Params] = ()
) -> Proposal:
    """Choose what a trial tries: a function of the arguments alone.

    The first trial is the variant's own configuration, then follow random draws, then a Gaussian process. The
    process is refitted from the finished trials with a seed of its own at every trial, so that an interrupted
    study goes on exactly as an uninterrupted one. A trial that was pruned or failed counts as no better than
    the worst completed one: the process would otherwise not see it and propose it again.

    Args:
        spec: the study.
        index: the trial.
        finished: trials that it may know the results of, in order.
        pending: hyperparameters of the trials that run beside it.
    """
    if index == 0:
        params, origin = nearest_params(spec.search, spec.base_config.to_dict()), "default"
    else:
        params, origin = _suggestion(spec, finished, pending, seed=derived_seed(spec.seed, index, 0))
    return proposal_of(spec, index, params, origin=origin)


def proposal_of(spec: StudySpec, index: int, params: Params, *, origin: str) -> Proposal:
    """Return the proposal with hyperparameters that are known already, as of a trial that was interrupted."""
    return Proposal(
        params,
        config=spec.base_config.replace(**to_settings(params)),
        seed=derived_seed(spec.seed, index, 1),
        origin=origin,
    )


def _suggestion(
    spec: StudySpec, finished: Sequence[TrialRecord], pending: Sequence[Params], *, seed: int
) -> tuple[Params, str]:
    """Ask Optuna's sampler, in a study of its own."""
    space = distributions(spec.search)
    study = _memory_study(seed)
    completed = [record.value for record in finished if record.state == "complete"]
    worst = max((value for value in completed if value is not None), default=None)
    known = finished if worst is not None else ()
    for record in known:
        value = record.value if record.state == "complete" else worst
        study.add_trial(create_trial(params=dict(record.params), distributions=space, value=value))
    for params in pending:
        study.add_trial(create_trial(state=OptunaState.RUNNING, params=dict(params), distributions=space))
    origin = "random" if len(known) < N_STARTUP_TRIALS else "gp"
    return dict(study.ask(space).params), origin


def _memory_study(seed: int) -> optuna.Study:
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.GPSampler(seed=seed, n_startup_trials=N_STARTUP_TRIALS)
    return optuna.create_study(direction="minimize", sampler=sampler)


def derived_seed(seed: int, *path: int) -> int:
    """Derive an independent seed from a seed and whole numbers that name its use."""
    return int(np.random.SeedSequence([seed, *path]).generate_state(1)[0])
