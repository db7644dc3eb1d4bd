"""A study of a user's objective: what it is declared with, and what its trials have come to."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from simulation.arrays import digest_of
from studies.results.declaration import StudyDeclaration
from studies.results.trials import STATES

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial


@dataclass(frozen=True, kw_only=True)
class ObjectiveDeclaration(StudyDeclaration):
    """One Optuna study of an objective; the function itself comes from each command that works on it.

    Args:
        values: names of what the objective returns, in its order. Length m.
        maximize: those of them that are maximized; the others are minimized.
    """

    values: tuple[str, ...]
    maximize: tuple[str, ...] = ()

    @cached_property
    def name(self) -> str:
        """Name of the Optuna study, for example `sphere/1a2b3c4d`."""
        decisive = ("sampler", "pruner", "seed", "values", "maximize", "project")
        declared = {name: value for name, value in self.to_dict().items() if name in decisive}
        return f"{self.label}/{digest_of(json.dumps(declared, sort_keys=True))[:8]}"

    @property
    def value_names(self) -> tuple[str, ...]:
        """Names of what a trial returns."""
        return self.values


@dataclass(frozen=True)
class TunedObjective:
    """What a study of an objective has come to.

    Attributes:
        spec: What it was declared with.
        number: Optuna's number of it; a later one has a larger one.
        attrs: Attributes of the study.
        trials: Its places, in order: of each trial the latest retry, as Optuna has it.
        best: The best feasible trial; of several values all those of which no other one is better in one and
            not worse in any (the Pareto set), by the first value.
    """

    spec: ObjectiveDeclaration
    number: int
    attrs: Mapping[str, Any]
    trials: Sequence["FrozenTrial"]
    best: Sequence["FrozenTrial"]

    def count(self, *states: str) -> int:
        """Return the number of trials in some states."""
        return sum(_state(one) in states for one in self.trials)

    @property
    def n_ended(self) -> int:
        """Trials that have ended, with whatever result."""
        return self.count("complete", "pruned", "failed")

    @property
    def n_planned(self) -> int:
        """Trials it shall have; more where a user added some."""
        return max(int(self.attrs.get("n_trials", 0)), len(self.trials))

    def row(self, trial: "FrozenTrial") -> dict[str, Any]:
        """Return what programs read of a trial; `wall_s` is in s."""
        return {
            "trial": trial.number,
            "state": _state(trial),
            "params": dict(trial.params),
            "values": dict(zip(self.spec.values, map(_finite, values_of(trial)), strict=False)),
            "constraints": {name: _finite(value) for name, value in trial.constraints.items()},
            "run_id": trial.user_attrs.get("mlflow_run_id"),
            "wall_s": trial.duration.total_seconds() if trial.duration else None,
            "reason": trial.user_attrs.get("reason", ""),
        }

    def to_dict(self) -> dict[str, Any]:
        """Return what programs read."""
        counts = {"n_planned": self.n_planned, **{f"n_{state}": self.count(state) for state in STATES}}
        aims = {"values": self.spec.values, "maximize": self.spec.maximize}
        return {"study": self.spec.name, **counts, **aims, "best": [self.row(one) for one in self.best]}


def values_of(trial: "FrozenTrial") -> Sequence[float]:
    """Return what a trial came to; nothing where it has come to nothing."""
    return trial.values or ()


def _finite(value: float) -> float | None:
    """Return a number as JSON has it; a user may have added a trial of an infinite one through Optuna."""
    return value if math.isfinite(value) else None


def _state(trial: "FrozenTrial") -> str:
    return {"fail": "failed"}.get(name := trial.state.name.lower(), name)
