"""Which hyperparameters a trial tries: a function of the trials before it."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import optuna
from optuna.samplers import BaseSampler
from optuna.trial import TrialState as OptunaState
from optuna.trial import create_trial

from pelsvae.config import SurrogateConfig
from studies.tuning.coordinates import Params, all_points, distributions, identity, to_settings
from studies.tuning.known_good import N_WARM_STARTS, Neighbour, declared_tries, neighbour_tries
from studies.tuning.pruning import expected_end
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord

N_STARTUP_TRIALS = 5
N_OTHER_DRAWS = 100  # in search of a configuration that was not tried; a small space is then listed in full


class SearchExhaustedError(Exception):
    """Every configuration of the search space has been tried."""


@dataclass(frozen=True)
class Proposal:
    """What a trial tries.

    Args:
        params: its hyperparameters in search coordinates.
        config: all settings of the surrogate.
        seed: seed of its training.
        origin: why these hyperparameters, such as "default", "random", "gp" or "tpe".
    """

    params: Params
    config: SurrogateConfig
    seed: int
    origin: str


def propose(
    spec: StudySpec,
    index: int,
    finished: Sequence[TrialRecord],
    pending: Sequence[Params] = (),
    *,
    neighbours: Callable[[], Sequence[Neighbour]] = tuple,
) -> Proposal:
    """Choose what a trial tries: a function of the arguments alone.

    First come the variant's own configuration, those of the profile and, where the study asks for it, the
    best ones of the nearest size; then random draws, then a Gaussian process (for two errors TPE). It is
    fitted anew to the finished trials, with a seed of its own, at every trial, so that an interrupted study
    goes on exactly as an uninterrupted one. No configuration is tried twice.

    Args:
        spec: the study.
        index: the trial.
        finished: trials that it may know the results of, in order.
        pending: hyperparameters of the trials that run beside it.
        neighbours: finds the finished studies of other sizes; asked where a trial starts from one.

    Raises:
        SearchExhaustedError: nothing is left to be tried.
    """
    taken = {identity(params) for params in (*(record.params for record in finished), *pending)}
    tries = declared_tries(spec)
    if index < len(tries):
        return proposal_of(spec, index, tries[index].params, origin=tries[index].origin)
    if spec.warm_start and index < len(tries) + N_WARM_STARTS:
        for known in neighbour_tries(spec, neighbours()):
            if identity(known.params) not in taken:
                return proposal_of(spec, index, known.params, origin=known.origin)
    params, origin = _suggestion(spec, finished, pending, seed=derived_seed(spec.seed, index, 0))
    if identity(params) in taken:
        params, origin = _untried(spec, index, taken), f"random, as {origin} repeated a trial"
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
    origin, sampler = _sampler(spec, seed)
    study = _memory_study(sampler, n_objectives=len(spec.objectives))
    told = _errors_told(spec, finished)
    for record, values in zip(finished, told, strict=False):
        study.add_trial(create_trial(params=dict(record.params), distributions=space, values=values))
    for params in pending:
        study.add_trial(create_trial(state=OptunaState.RUNNING, params=dict(params), distributions=space))
    return dict(study.ask(space).params), origin if len(told) >= N_STARTUP_TRIALS else "random"


def _sampler(spec: StudySpec, seed: int) -> tuple[str, BaseSampler]:
    """Return the sampler that follows the random draws: with two errors TPE is no worse and much faster."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        if len(spec.objectives) > 1:
            return "tpe", optuna.samplers.TPESampler(
                seed=seed, n_startup_trials=N_STARTUP_TRIALS, multivariate=True, constant_liar=True
            )
        return "gp", optuna.samplers.GPSampler(seed=seed, n_startup_trials=N_STARTUP_TRIALS)


def _errors_told(spec: StudySpec, finished: Sequence[TrialRecord]) -> list[list[float]]:
    """Return what the sampler is told of every finished trial, nothing while none is complete.

    Of a pruned trial it is told the error that the trial was heading for, of a failed one the worst error of
    all: it would otherwise not see them and propose them again.
    """
    complete = [record for record in finished if record.state == "complete"]
    if not complete:
        return []
    known: list[list[float] | None] = []
    for record in finished:
        if record.state == "complete":
            known.append([record.metrics[name] for name in spec.objectives])
        elif record.state == "pruned" and len(spec.objectives) == 1:
            end = expected_end(record, complete)
            known.append(None if end is None else [end])
        else:
            known.append(None)
    worst = [max(column) for column in zip(*(values for values in known if values), strict=True)]
    return [values or worst for values in known]


def _untried(spec: StudySpec, index: int, taken: set[tuple[tuple[str, str], ...]]) -> Params:
    """Draw a configuration that was not tried.

    Raises:
        SearchExhaustedError: there is none.
    """
    space = distributions(spec.search)
    for draw in range(1, N_OTHER_DRAWS + 1):
        sampler = optuna.samplers.RandomSampler(seed=derived_seed(spec.seed, index, 0, draw))
        params: Params = dict(_memory_study(sampler).ask(space).params)
        if identity(params) not in taken:
            return params
    left = [point for point in all_points(spec.search) or () if identity(point) not in taken]
    if not left:
        raise SearchExhaustedError(
            f"every configuration of the search space has been tried ({len(taken)}); widen [tuning.search]"
        )
    return left[derived_seed(spec.seed, index, 0) % len(left)]


def _memory_study(sampler: BaseSampler, n_objectives: int = 1) -> optuna.Study:
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    return optuna.create_study(directions=["minimize"] * n_objectives, sampler=sampler)


def derived_seed(seed: int, *path: int) -> int:
    """Derive an independent seed from a seed and whole numbers that name its use."""
    return int(np.random.SeedSequence([seed, *path]).generate_state(1)[0])
