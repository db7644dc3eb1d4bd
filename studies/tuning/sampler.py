"""Optuna's samplers and pruners by name, and the seeds that make a study repeatable."""

from collections.abc import Mapping
from importlib.util import find_spec
from inspect import signature
from typing import Any, TypeVar

import optuna
from optuna.pruners import BasePruner
from optuna.samplers import BaseSampler
from optuna.trial import FrozenTrial, TrialState

from simulation.errors import InputError
from simulation.foreign_text import quoted
from studies.installed import installed_class
from studies.results.declaration import StudyDeclaration
from studies.tuning.attempts import experimental

_Made = TypeVar("_Made")
_NEEDS = {"CmaEsSampler": "cmaes"}
"""Packages that Optuna imports only when it proposes, long after the simulations were paid for."""
# Each trial has a sampler of its own: with a seed per trial they would mix several sequences.
_ONE_SEQUENCE = ("QMCSampler", "GridSampler", "BruteForceSampler")
"""Samplers that go through one sequence: each trial takes the same seed, not one of its own."""


def make_sampler(declared: Mapping[str, Any], seed: int) -> BaseSampler:
    """Make a sampler of `optuna.samplers`, or an installed `module:Class`, from its name and arguments.

    Raises:
        InputError: there is no such sampler, or it refuses the arguments.
    """
    return _made("sampler", declared, vars(optuna.samplers), BaseSampler, seed=seed)


def make_pruner(declared: Mapping[str, Any]) -> BasePruner:
    """Make a pruner of `optuna.pruners`, ours, or an installed `module:Class`, from its name and arguments.

    Raises:
        InputError: there is no such pruner, or it refuses the arguments.
    """
    known = vars(optuna.pruners) | {"CatchUpPruner": CatchUpPruner}
    return _made("pruner", declared, known, BasePruner)


def _made(
    kind: str, declared: Mapping[str, Any], known: Mapping[str, Any], base: type[_Made], **more: Any
) -> _Made:
    name, arguments = str(declared.get("name")), {k: v for k, v in declared.items() if k != "name"}
    offered = {n: v for n, v in known.items() if isinstance(v, type) and issubclass(v, base) and v != base}
    found = _installed(kind, name, base) if ":" in name else offered.get(name)
    if found is None:
        others = f"or a class of an installed package, as package.module:{kind.title()}"
        has = f"it has {', '.join(sorted(offered))}; {others}"
        raise InputError(f"tuning.{kind}: Optuna has no {kind} {quoted(name)}; {has}")
    if (needed := _NEEDS.get(name)) is not None and find_spec(needed) is None:
        raise InputError(f"tuning.{kind}: {name} needs the package {needed}; type: pip install {needed}")
    arguments = {
        # Some take another one as an argument, as PatientPruner does.
        key: _made(kind, value, known, base, **more) if isinstance(value, dict) and "name" in value else value
        for key, value in arguments.items()
    }
    # Not every sampler has a seed.
    takes = {key: value for key, value in more.items() if key in signature(found).parameters}
    try:
        with experimental():
            return found(**(takes | arguments))
    except (TypeError, ValueError) as error:
        raise InputError(f"tuning.{kind}: {name} refuses its arguments: {error}") from None
    except ImportError as error:
        raise InputError(f"tuning.{kind}: {name} needs a package that is not installed: {error}") from None


def _installed(kind: str, name: str, base: type[_Made]) -> type[_Made]:
    """Return a sampler or pruner of an installed package by `module:Class`."""
    found = installed_class(f"tuning.{kind}", name)
    if not issubclass(found, base):
        raise InputError(f"tuning.{kind}: {quoted(name)} is no {kind}; name one of Optuna's kind")
    return found


def sampler_of_place(spec: StudyDeclaration, place: int) -> BaseSampler:
    """Return the sampler of one trial, seeded by the study's seed and the trial's place.

    So a study that was interrupted, or whose worker died, goes on as the undisturbed one would have.
    """
    is_one_sequence = spec.sampler.get("name") in _ONE_SEQUENCE
    return make_sampler(spec.sampler, spec.trial_seed(0 if is_one_sequence else place, 0))


# With one-cycle, ranks at a tenth of the epochs correlate with the end by 0.37, at half by 0.92.
class CatchUpPruner(BasePruner):
    """Stops a trial that could not catch up with the best one any more.

    It would miss the best completed trial even if its error fell from here on by a larger factor than that
    of any completed trial: the largest factor seen, to the power of 1 + caution / n with n completed trials.
    With a one-cycle learning rate that factor is large early in a training and 1 late, which a median
    ignores.

    Args:
        caution: how much more than any completed trial one may still gain, divided by their number.
    """

    # Replays of four studies of 12 trials take 41 to 53 % of the epochs for the same best error; with a
    # factor of the fallen part in the place of the power 47 to 70 %.
    def __init__(self, caution: float = 1.5) -> None:
        self._caution = caution

    def prune(self, study: optuna.Study, trial: FrozenTrial) -> bool:
        """Say whether the trial is to be stopped, judged by what it has reported."""
        step = trial.last_step
        if step is None:
            return False
        # Pruned trials are no evidence: what they would still have gained is not known.
        complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        parts = [
            other.value / least
            for other in complete
            if other.value is not None and (least := least_until(other, step))
        ]
        # The least so far on both sides, as the best epoch's weights are taken in the end.
        least = least_until(trial, step)
        if not parts or least is None:
            return False
        left: float = min(parts) ** (1.0 + self._caution / len(parts))
        return least * left > min(other.value for other in complete if other.value is not None)


def least_until(trial: FrozenTrial, step: int) -> float | None:
    """Return the least value that a trial reported up to a step, None where it reported none."""
    return min((value for at, value in trial.intermediate_values.items() if at <= step), default=None)
