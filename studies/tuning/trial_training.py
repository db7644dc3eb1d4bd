"""Train and judge the surrogate of one trial."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pelsvae.config import SurrogateConfig
from pelsvae.epochs import EpochReport, TrainingDiverged
from pelsvae.metrics import errors
from pelsvae.training import FitResult, fit
from studies.tuning.pruning import PRUNED
from studies.tuning.study_data import StudyData
from studies.tuning.study_spec import StudySpec, TrialState, output_metric

N_REPORTS = 16  # enough to stop a trial in time; all of them are kept in its record
PRUNE_AFTER = 0.1  # part of the epochs before trials are compared
HISTORY = ("epoch", "loss", "validation_mae")  # what is known of a trial without a surrogate
NORMAL_90 = 1.6449  # standard deviations to both sides that hold 90 % of a normal distribution


class _PrunedError(Exception):
    """The trial is not worth its other epochs."""


@dataclass
class TrialOutcome:
    """What is known of a trial as it goes; becomes a record at its end."""

    state: TrialState = "failed"
    reason: str = ""
    fitted: FitResult | None = None
    n_epochs: int = 0
    metrics: dict[str, float] = field(default_factory=dict)
    reports: dict[str, float] = field(default_factory=dict)
    history: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in HISTORY})


def report_epochs(max_epochs: int) -> list[int]:
    """Return the epochs at which trials are compared: a geometric row, dense where most trials stop."""
    row = np.geomspace(max(1.0, PRUNE_AFTER * max_epochs), max_epochs, N_REPORTS)
    return sorted({round(epoch) for epoch in row})


def train_trial(
    spec: StudySpec,
    config: SurrogateConfig,
    seed: int,
    data: StudyData,
    *,
    n_jobs: int = 1,
    outcome: TrialOutcome,
    on_epoch: Callable[[EpochReport], None],
    is_hopeless: Callable[[int, float], bool],
) -> None:
    """Train a surrogate, judge it, and note in `outcome` how it went.

    Args:
        spec: the study.
        config: settings of the surrogate.
        seed: seed of the training.
        data: the three sets.
        n_jobs: threads of this training.
        outcome: filled as the training goes; also what is known when this raises.
        on_epoch: told of every validated epoch; whatever it raises ends the training.
        is_hopeless: told of epoch and validation error where trials are compared;
            says whether the trial shall be pruned.

    Raises:
        TrainingDiverged: the errors of the trained surrogate are not finite.
    """
    steps = report_epochs(config.max_epochs)
    scales = np.array(spec.output_scales)

    def hear(report: EpochReport) -> None:
        on_epoch(report)
        outcome.n_epochs = report.epoch
        seen = (report.epoch, report.train_loss, report.validation_mae)
        for name, value in zip(HISTORY, seen, strict=True):
            outcome.history[name].append(value)
        # Of processes only the last report is of the surrogate; the others are of parts of the rows.
        due = [step for step in steps if step <= report.epoch] if config.regressor == "network" else []
        if due and str(due[-1]) not in outcome.reports:
            outcome.reports[str(due[-1])] = report.validation_mae
            if is_hopeless(due[-1], report.validation_mae) and report.epoch < report.max_epochs:
                raise _PrunedError

    try:
        fitted = fit(
            *data.train,
            data.validation,
            config=config,
            seed=seed,
            log_columns=spec.parameter_space.is_log,
            output_scales=scales,
            n_jobs=n_jobs,
            on_epoch=hear,
        )
    except _PrunedError:
        outcome.state = "pruned"
        outcome.reason = f"{PRUNED[spec.pruner]} at epoch {outcome.n_epochs}"
        outcome.metrics = {"val/mae": min(outcome.history["validation_mae"])}
        return
    judged: dict[str, float] = {}
    for name, (theta, y) in {"val": data.validation, "test": data.test}.items():
        predicted = fitted.surrogate.predict(theta)
        error = errors(predicted, y, scales)
        judged |= {f"{name}/mae": float(error.mae), f"{name}/p90": float(error.p90)}
        if len(spec.output_names) > 1:
            by_output = np.abs(predicted - y).mean(axis=(0, 1))
            judged |= {
                f"{name}/{output_metric(output)}": float(mae)
                for output, mae in zip(spec.output_names, by_output, strict=True)
            }
        if name == "test" and fitted.surrogate.states_deviation:
            inside = np.abs(predicted - y) <= NORMAL_90 * fitted.surrogate.deviation(theta)
            judged["test/coverage90"] = float(inside.mean())
    outcome.n_epochs = fitted.n_epochs
    if not all(map(math.isfinite, judged.values())):
        raise TrainingDiverged("the errors of the trained surrogate are not finite")
    outcome.state, outcome.reason = "complete", fitted.stop_reason
    outcome.metrics, outcome.fitted = judged, fitted
