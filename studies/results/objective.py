"""A study of a user's objective: what it is declared with, and what its trials have come to."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from simulation.arrays import digest_of
from studies.results.declaration import StudyDeclaration
from studies.results.trials import STATES


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

    @property
    def directions(self) -> list[str]:
        """Whether each of these is minimized or maximized, in Optuna's words."""
        return ["maximize" if name in self.maximize else "minimize" for name in self.values]


@dataclass(frozen=True)
class ObjectiveTrial:
    """One place of a study: a trial, or the latest retry of it.

    Attributes:
        number: Optuna's number of the trial.
        state: "complete", "pruned", "failed", "running" or "waiting".
        params: what it tried.
        values: what the objective returned by name; of a pruned trial what it reported last.
        constraints: by name; a trial is feasible where none is positive.
        run_id: MLflow's run, empty without one.
        wall_s: its duration. [s]
        reason: why it was pruned or has failed.
    """

    number: int
    state: str
    params: Mapping[str, Any]
    values: Mapping[str, float]
    constraints: Mapping[str, float]
    run_id: str
    wall_s: float
    reason: str = ""

    @property
    def is_feasible(self) -> bool:
        """Whether it keeps all constraints."""
        return all(value <= 0.0 for value in self.constraints.values())


@dataclass(frozen=True)
class TunedObjective:
    """What a study of an objective has come to.

    Attributes:
        spec: What it was declared with.
        number: Optuna's number of it; a later one has a larger one.
        n_planned: Trials it shall have.
        run_id: MLflow's run of the study.
        trials: Its places, in order.
        best: The best feasible trial; of several objectives all those of which no other one is better in one
            value and not worse in any (the Pareto set), by the first value.
    """

    spec: ObjectiveDeclaration
    number: int
    n_planned: int
    run_id: str
    trials: tuple[ObjectiveTrial, ...]
    best: tuple[ObjectiveTrial, ...]

    def count(self, state: str) -> int:
        """Return the number of trials in a state."""
        return sum(one.state == state for one in self.trials)

    @property
    def n_ended(self) -> int:
        """Trials that have ended, with whatever result."""
        return self.count("complete") + self.count("pruned") + self.count("failed")

    @property
    def to_go_s(self) -> float | None:
        """Time of the trials to come, one after the other; None before the first one. [s]."""
        n_left = max(self.n_planned - self.n_ended, 0)
        timed = [one.wall_s for one in self.trials if one.wall_s]
        return n_left * sum(timed) / len(timed) if timed else None if n_left else 0.0

    def to_dict(self) -> dict[str, Any]:
        """Return what programs read."""
        about = {"label": self.spec.label, "study": self.spec.name, "run_id": self.run_id}
        counts = {"n_planned": self.n_planned, **{f"n_{state}": self.count(state) for state in STATES}}
        aims = dict(zip(self.spec.values, self.spec.directions, strict=True))
        return {**about, **counts, "values": aims, "best": [asdict(one) for one in self.best]}
