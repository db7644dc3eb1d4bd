"""A trial as MLflow shows it: a run that is open while the trial goes on.

What the run says of the trial's end is taken from Optuna, which owns it: by the worker itself, or, where that
died, by whoever comes next.
"""

import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from optuna.trial import FrozenTrial, TrialState

from studies.results.declaration import StudyDeclaration
from studies.tracking.quiet_mlflow import entities
from studies.tracking.runs import RunStore
from studies.tracking.study_tags import PARENT

FLUSH_S = 2.0
"""Points of curves are written this often: each call costs as much as many points."""
MOST_POINTS = 1000  # that MLflow takes in one call


class TrialRun:
    """The MLflow run of one trial that is being worked on.

    Args:
        runs: the project's runs.
        spec: the study.
        study_run: id of the study's run.
        trial: number of the trial.
        params: its hyperparameters and all that is to be seen beside them.
        about: what makes all trials of the study again.
    """

    def __init__(
        self,
        runs: RunStore,
        spec: StudyDeclaration,
        study_run: str,
        *,
        trial: int,
        params: dict[str, Any],
        about: dict[str, Any],
    ) -> None:
        parent = {PARENT: study_run} if study_run else {}
        tags = {"role": spec.role, "study": spec.name, "trial": trial, **spec.about, **parent}
        self.id = runs.begin(spec.label, f"{spec.size} trial {trial:03d}", tags)
        self._runs, self._about = runs, about
        self._points: list[entities.Metric] = []
        self._flushed_s = -math.inf
        runs.log(self.id, params={**spec.about, **params})

    def log(self, metrics: Mapping[str, float], step: int) -> None:
        """Write numbers that belong to a step, some points at a time."""
        now = round(1000.0 * time.time())
        finite = {name: value for name, value in metrics.items() if math.isfinite(value)}
        self._points += [entities.Metric(name, value, now, step) for name, value in finite.items()]
        if time.monotonic() - self._flushed_s >= FLUSH_S:
            self.flush()

    def show(self, params: Mapping[str, Any]) -> None:
        """Write settings."""
        self._runs.log(self.id, params=params)

    def keep(self, files: Sequence[Path], folder: str | None) -> None:
        """Copy files among the artifacts."""
        self._runs.log_files(self.id, files, folder)

    def write(self, record: Mapping[str, Any]) -> None:
        """Write what makes the trial again, beside what makes all of the study, as `provenance.json`."""
        self._runs.log_record(self.id, {**self._about, **record})

    def flush(self) -> None:
        """Write what is not yet written of the curves."""
        points, self._points = self._points, []
        for start in range(0, len(points), MOST_POINTS):
            self._runs.client.log_batch(self.id, points[start : start + MOST_POINTS])
        self._flushed_s = time.monotonic()


def end_run(runs: RunStore, run_id: str, trial: FrozenTrial, spec: StudyDeclaration) -> None:
    """Let a trial's run say what Optuna says of the trial.

    Args:
        runs: the project's runs.
        run_id: the trial's run.
        trial: the trial; one that still runs or waits was given to another worker, so this run is over.
        spec: its study.
    """
    state = trial.state.name.lower()
    tags = {"trial_state": state, "pruned": trial.state == TrialState.PRUNED}
    is_failed, is_over = trial.state == TrialState.FAIL, trial.state.is_finished()
    usual = "its worker died" if is_failed else "" if is_over else "its worker was stopped"
    if reason := trial.user_attrs.get("reason") or usual:
        tags["reason"] = reason
    runs.log(run_id, metrics=spec.results_of(state, trial.values, trial.user_attrs), tags=tags)
    runs.end(run_id, "FAILED" if is_failed else "FINISHED" if is_over else "KILLED")
