"""What figures and tables of tuning draw: every trial, and how a training went.

Shapes use m trials, e epochs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from studies.report.records import Booleans, Floats, Integers, require_shape

TRIAL_STATES = ("complete", "pruned", "failed", "running")


@dataclass(frozen=True)
class TrialsRecord:
    """Every trial of every study, one entry per trial; NaN where an error is unknown.

    Attributes:
        n_train: Training-set size of the trial's study. Shape (m,).
        state: One of `TRIAL_STATES` per trial, m entries.
        validation_mae: For a pruned trial the last one reported. Shape (m,). [output unit, differences]
        test_mae: Shape (m,). [output unit, differences]
        test_p90: Shape (m,). [output unit, differences]
        is_best: True for the trial chosen by validation error, at most one per size. Shape (m,).
    """

    n_train: Integers
    state: tuple[str, ...]
    validation_mae: Floats
    test_mae: Floats
    test_p90: Floats
    is_best: Booleans

    def __post_init__(self) -> None:
        shape = (len(self.state),)
        for what in ("n_train", "validation_mae", "test_mae", "test_p90", "is_best"):
            require_shape(f"the trials' {what}", getattr(self, what), shape)
        unknown = sorted(set(self.state) - set(TRIAL_STATES))
        if unknown:
            raise ValueError(f"unknown trial state {unknown[0]!r}, expected one of {', '.join(TRIAL_STATES)}")


@dataclass(frozen=True)
class TunedRecord:
    """The best surrogate of one training-set size.

    Attributes:
        n_train: Size of the training set.
        hyperparameters: What Optuna chose, by name.
        test_mae: [output unit, differences]
        test_p90: 90th percentile of the absolute errors. [output unit, differences]
        validation_mae: [output unit, differences]
        gain: Part of the default configuration's validation MAE that tuning took away; NaN if unknown. [1]
        baseline_mae: Of PCA + GP on the same sets; NaN without. [output unit, differences]
        baseline_p90: Of PCA + GP on the same sets; NaN without. [output unit, differences]
        n_complete: Trials trained to their end.
        n_pruned: Trials stopped early.
        n_failed: Trials that failed.
    """

    n_train: int
    hyperparameters: Mapping[str, float | int | str]
    test_mae: float
    test_p90: float
    validation_mae: float
    gain: float
    baseline_mae: float
    baseline_p90: float
    n_complete: int
    n_pruned: int
    n_failed: int


@dataclass(frozen=True)
class LearningCurves:
    """How one training went; NaN at epochs without a validation.

    Attributes:
        n_train: Size of the training set.
        epoch: Shape (e,).
        validation_mae: Shape (e,). [output unit, differences]
        terms: Training-loss terms by name ("loss", "kl", "reconstruction", ...), each of shape (e,). [1]
        best_epoch: The epoch whose weights were kept.
        stop_reason: Why the training ended, in words.
    """

    n_train: int
    epoch: Integers
    validation_mae: Floats
    terms: tuple[tuple[str, Floats], ...]
    best_epoch: int
    stop_reason: str = ""

    def __post_init__(self) -> None:
        require_shape("the validation MAE", self.validation_mae, self.epoch.shape)
        for name, values in self.terms:
            require_shape(f"the loss term {name}", values, self.epoch.shape)
