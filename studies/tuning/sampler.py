"""Optuna's samplers and pruners by name, and seeds that make a study repeatable."""

from collections.abc import Callable, Mapping
from inspect import signature
from typing import Any

import optuna
from optuna.distributions import BaseDistribution
from optuna.pruners import BasePruner
from optuna.samplers import BaseSampler
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial, TrialState

from simulation.errors import InputError
from studies.tuning.declaration import Declaration
from studies.tuning.owner import this_process
from studies.tuning.pruner import CatchUpPruner
from studies.tuning.storage import OWNER, place_of

PROPOSED_BY = "proposed_by"
_OWN_PRUNERS = {"CatchUpPruner": CatchUpPruner}
_ONE_SEQUENCE = ("QMCSampler", "GridSampler", "BruteForceSampler")
"""Samplers that go through one sequence: each trial takes the same seed, not one of its own."""


def make_sampler(declared: Mapping[str, Any], seed: int) -> BaseSampler:
    """Make a sampler of `optuna.samplers` from its name and arguments.

    Raises:
        InputError: there is no such sampler, or it refuses the arguments.
    """
    return _made("sampler", declared, vars(optuna.samplers), BaseSampler, seed=seed)  # type: ignore[no-any-return]


def make_pruner(declared: Mapping[str, Any]) -> BasePruner:
    """Make a pruner of `optuna.pruners`, or ours, from its name and arguments.

    Raises:
        InputError: there is no such pruner, or it refuses the arguments.
    """
    return _made("pruner", declared, vars(optuna.pruners) | _OWN_PRUNERS, BasePruner)  # type: ignore[no-any-return]


def _made(kind: str, declared: Mapping[str, Any], known: Mapping[str, Any], base: type, **more: Any) -> Any:
    name, arguments = declared.get("name"), {k: v for k, v in declared.items() if k != "name"}
    found = known.get(str(name))
    if not isinstance(found, type) or not issubclass(found, base) or found is base:
        offered = sorted(
            n for n, v in known.items() if isinstance(v, type) and issubclass(v, base) and v is not base
        )
        raise InputError(f"tuning.{kind}: Optuna has no {kind} {name!r}; it has {', '.join(offered)}")
    arguments = {
        key: _made(kind, value, known, base, **more) if isinstance(value, dict) and "name" in value else value
        for key, value in arguments.items()
    }
    takes = {key: value for key, value in more.items() if key in signature(found).parameters}
    try:
        return found(**(takes | arguments))
    except (TypeError, ValueError) as error:
        raise InputError(f"tuning.{kind}: {name} refuses its arguments: {error}") from None


class RepeatableSampler(BaseSampler):
    """Asks a fresh sampler at each trial, seeded by the study's seed and the trial's place.

    So a study that was interrupted, or whose worker died, goes on as the undisturbed one would have.

    Args:
        spec: the study.
        storage: where it lies; hears that the trial has begun and who works on it before anything else.
        on_begun: called once the trial is begun.
    """

    def __init__(self, spec: Declaration, storage: RDBStorage, on_begun: Callable[[], None]) -> None:
        self._spec, self._storage, self._on_begun = spec, storage, on_begun
        self._sampler = self._fresh(0)

    def before_trial(self, study: optuna.Study, trial: FrozenTrial) -> None:
        """Note who works on the trial, and make its sampler."""
        # Optuna's own heartbeat begins with the objective: a kill before it would leave a running trial.
        trial_id = self._trial_id(study, trial)
        self._storage.record_heartbeat(trial_id)
        self._storage.set_trial_user_attr(trial_id, OWNER, {"trial": trial.number, **this_process()})
        self._on_begun()
        self._sampler = self._fresh(place_of(trial, study.get_trials(deepcopy=False)))
        self._sampler.before_trial(study, trial)

    def infer_relative_search_space(
        self, study: optuna.Study, trial: FrozenTrial
    ) -> dict[str, BaseDistribution]:
        """Ask the sampler."""
        return self._sampler.infer_relative_search_space(study, trial)

    def sample_relative(
        self, study: optuna.Study, trial: FrozenTrial, search_space: dict[str, BaseDistribution]
    ) -> dict[str, Any]:
        """Ask the sampler, and note that it had results to propose from."""
        params = self._sampler.sample_relative(study, trial, search_space)
        if params and PROPOSED_BY not in trial.user_attrs:
            name = type(self._sampler).__name__
            self._storage.set_trial_user_attr(self._trial_id(study, trial), PROPOSED_BY, name)
        return params

    def sample_independent(
        self,
        study: optuna.Study,
        trial: FrozenTrial,
        param_name: str,
        param_distribution: BaseDistribution,
    ) -> Any:
        """Ask the sampler."""
        return self._sampler.sample_independent(study, trial, param_name, param_distribution)

    def after_trial(self, study: optuna.Study, trial: FrozenTrial, state: TrialState, values: Any) -> None:
        """Tell the sampler."""
        self._sampler.after_trial(study, trial, state, values)

    def _fresh(self, place: int) -> BaseSampler:
        is_one_sequence = self._spec.sampler.get("name") in _ONE_SEQUENCE
        return make_sampler(self._spec.sampler, self._spec.trial_seed(0 if is_one_sequence else place, 0))

    def _trial_id(self, study: optuna.Study, trial: FrozenTrial) -> int:
        study_id = self._storage.get_study_id_from_name(study.study_name)
        return self._storage.get_trial_id_from_study_id_trial_number(study_id, trial.number)
