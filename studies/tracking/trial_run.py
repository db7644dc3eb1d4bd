"""A trial as MLflow shows it: a run that is open while the training goes on.

What the run says of the trial's end is taken from Optuna, which owns it: by the worker itself, or, where that
died, by whoever comes next.
"""

import math
import time
from typing import Any

from optuna.trial import FrozenTrial, TrialState

from pelsvae.epochs import EpochReport
from studies.results.declaration import Declaration
from studies.results.trials import errors_of
from studies.tracking.quiet_mlflow import entities
from studies.tracking.runs import CURVE, VALIDATION_MAE, RunStore
from studies.tracking.study_tags import PARENT

N_POINTS = 100
"""Most of the loss and of each of its terms; the validation error is written at every validated epoch."""
FLUSH_S = 2.0
"""Points of curves are written this often: each call costs as much as many points."""


class TrialRun:
    """The MLflow run of one trial that is being trained.

    Args:
        runs: the project's runs.
        spec: the study.
        study_run: id of the study's run.
        trial: number of the trial.
        params: its hyperparameters and all that is to be seen beside them.
        record: what makes the trial again, kept as `provenance.json`.
    """

    def __init__(
        self,
        runs: RunStore,
        spec: Declaration,
        study_run: str,
        *,
        trial: int,
        params: dict[str, Any],
        record: dict[str, Any],
    ) -> None:
        parent = {PARENT: study_run} if study_run else {}
        tags = {"role": spec.role, "study": spec.name, "trial": trial, "n_train": spec.n_train, **parent}
        self.id = runs.begin(spec.label, f"{spec.size} trial {trial:03d}", tags)
        self._runs = runs
        self._points: list[entities.Metric] = []
        self._next_terms = 1
        self._flushed_s = time.monotonic()
        runs.log(self.id, params={"n_train": spec.n_train, **params})
        runs.log_record(self.id, record)

    def log(self, report: EpochReport) -> None:
        """Write the learning curves, some points at a time."""
        now = round(1000.0 * time.time())
        seen = {VALIDATION_MAE: report.validation_mae}
        # Validated epochs may be rarer: a multiple of both numbers would be rarer still.
        if report.epoch >= self._next_terms:
            self._next_terms = report.epoch + math.ceil(report.max_epochs / N_POINTS)
            seen |= {"loss": report.train_loss, **report.terms}
        finite = {name: value for name, value in seen.items() if math.isfinite(value)}
        self._points += [entities.Metric(f"{CURVE}{k}", v, now, report.epoch) for k, v in finite.items()]
        if time.monotonic() - self._flushed_s >= FLUSH_S:
            self.flush()

    def flush(self) -> None:
        """Write what is not yet written of the curves."""
        points, self._points = self._points, []
        self._runs.client.log_batch(self.id, points)
        self._flushed_s = time.monotonic()


def end_run(runs: RunStore, run_id: str, trial: FrozenTrial) -> None:
    """Let a trial's run say what Optuna says of the trial.

    Args:
        runs: the project's runs.
        run_id: the trial's run.
        trial: the trial; one that still runs or waits was given to another worker, so this run is over.
    """
    state = trial.state.name.lower()
    tags = {"trial_state": state, "pruned": trial.state == TrialState.PRUNED}
    is_failed, is_over = trial.state == TrialState.FAIL, trial.state.is_finished()
    usual = "its worker died" if is_failed else "" if is_over else "its worker was stopped"
    if reason := trial.user_attrs.get("reason") or usual:
        tags["reason"] = reason
    runs.log(run_id, metrics=errors_of(state, trial.value, trial.user_attrs), tags=tags)
    runs.end(run_id, "FAILED" if is_failed else "FINISHED" if is_over else "KILLED")
