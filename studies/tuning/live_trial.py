"""A trial while it is worked on: Optuna's, with a seed of its own and a run in MLflow that is open."""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import optuna
from optuna.distributions import BaseDistribution

from simulation.foreign_text import quoted
from studies.results.declaration import StudyDeclaration
from studies.tracking.runs import CURVE, metric_name
from studies.tracking.trial_run import TrialRun
from studies.tuning import attempts
from studies.words.wording import listed

CONSTRAINT = "constraint/"
"""Begins the names of metrics that are constraints."""


class TrialFailedError(Exception):
    """A configuration that has no result; the study goes on without it."""


Begin = Callable[[dict[str, Any]], TrialRun]
Objective = Callable[["LiveTrial"], float | Sequence[float]]
"""What a trial does: it takes the trial and returns its value, or several."""


class LiveTrial(optuna.Trial):
    """Optuna's trial, as an objective gets it: `suggest_float` and all else of it, and what follows.

    Attributes:
        seed: Seed of its random numbers: from it the same trial gives the same numbers.
        enqueued: The hyperparameters that it was enqueued with.
    """

    def __init__(
        self,
        trial: optuna.Trial,
        spec: StudyDeclaration,
        seed: int,
        begin: Begin,
        enqueued: Mapping[str, Any],
    ) -> None:
        """Take over a trial that Optuna has made: to make it again would draw again.

        Args:
            trial: Optuna's.
            spec: its study.
            seed: its seed.
            begin: opens its run, which shows settings.
            enqueued: the hyperparameters that it was enqueued with.
        """
        vars(self).update(vars(trial))
        self.seed, self.enqueued = seed, enqueued
        self.step = 0
        """The last one that something was written of."""
        self.stopped = ""
        """Why it is to be pruned."""
        self.run: TrialRun | None = None
        self._is_noted = False
        self._spec, self._begin, self._began_s = spec, begin, time.perf_counter()

    def begin(self, params: dict[str, Any]) -> TrialRun:
        """Open the trial's run.

        Args:
            params: settings that are shown beside what is suggested.
        """
        self.run = self._begin(params)
        self.set_user_attr(attempts.RUN_ID, self.run.id)
        return self.run

    @property
    def wall_s(self) -> float:
        """How long it has run. [s]."""
        return time.perf_counter() - self._began_s

    def log(self, metrics: Mapping[str, float], step: int = 0) -> None:
        """Show numbers in MLflow while the trial runs.

        Args:
            metrics: by name; what is no finite number is left out.
            step: which point of their curves they are.
        """
        self.step = max(self.step, step)
        if self.run is not None:
            self.run.log({metric_name(name): float(value) for name, value in metrics.items()}, step)

    def log_file(self, file: str | Path, folder: str | None = None) -> None:
        """Copy a file among the artifacts of the trial's run.

        Args:
            file: the file.
            folder: where among the artifacts; None for the top.
        """
        if self.run is not None:
            self.run.keep([Path(file)], folder)

    def report(self, value: float, step: int) -> None:
        """Report how far the trial is, for pruning, as Optuna; an objective's curve is shown in MLflow."""
        super().report(value, step)
        self.step = max(self.step, step)
        if self._spec.is_curve:
            self.log({f"{CURVE}{self._spec.value_names[0]}": value}, step)

    def should_prune(self) -> bool:
        """Say whether the trial should end now: by the study's pruner, or at its longest duration."""
        if self.is_late:
            return True
        if super().should_prune():
            self.stopped = f"pruned by {self._spec.pruner['name']} at {self._spec.step_word} {self.step}"
        return bool(self.stopped)

    @property
    def is_late(self) -> bool:
        """Whether it has reached its longest duration."""
        limit = self._spec.max_trial_s
        if limit is None or self.wall_s < limit:
            return False
        self.stopped = f"reached its limit of {limit:g} s at {self._spec.step_word} {self.step}"
        return True

    def set_constraint(self, key: str, value: float) -> None:
        """Set a constraint, as Optuna: the trial is feasible where none is positive."""
        super().set_constraint(key, value)
        self.log({f"{CONSTRAINT}{key}": value})

    def _suggest(self, name: str, distribution: BaseDistribution) -> Any:
        value = super()._suggest(name, distribution)
        if self.run is not None:
            self.run.show({name: value})
        return value

    def note(self, reason: str, **more: Any) -> None:
        """Note how the trial ended, before Optuna ends it; the first note counts."""
        if self._is_noted:
            return
        self._is_noted = True
        # Before the reason: whoever reads that a trial ended finds its curve complete.
        if self.run is not None:
            self.run.flush()
        self.set_user_attr("reason", reason)
        self.set_user_attr("training", {"n_epochs": self.step, "wall_s": self.wall_s, **more})


def finite_values(returned: Any, names: Sequence[str]) -> float | list[float]:
    """Return what an objective returned as Optuna takes it.

    Args:
        returned: a number, or one for each name.
        names: what it is to return. Length m.

    Raises:
        TrialFailedError: it is something else, or not finite.
    """
    try:
        values: list[float] = np.atleast_1d(np.asarray(returned, dtype=np.float64)).tolist()
    except (TypeError, ValueError):
        values = []
    if len(values) != len(names) or not all(map(math.isfinite, values)):
        said = quoted(str(returned))
        raise TrialFailedError(f"it returned {said}; return a finite number for {listed(names)}")
    return values[0] if len(values) == 1 else values
