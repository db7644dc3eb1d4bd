"""What figures and tables of tuning draw: every trial, and how a training went.

Shapes use m trials, e epochs.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from simulation.arrays import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class TrialsRecord:
    """Every trial of every study, one entry per trial; NaN where an error is unknown.

    Attributes:
        n_train: Training-set size of the trial's study. Shape (m,).
        state: "complete", "pruned", "failed" or "running" per trial, m entries.
        validation_mae: For a pruned trial the last one reported. Shape (m,). [output unit, differences]
        test_mae: Shape (m,). [output unit, differences]
        test_p90: Shape (m,). [output unit, differences]
        is_best: True for the trial chosen by validation error, at most one per size. Shape (m,).
    """

    n_train: IntArray
    state: tuple[str, ...]
    validation_mae: FloatArray
    test_mae: FloatArray
    test_p90: FloatArray
    is_best: BoolArray


@dataclass(frozen=True)
class ErrorLine:
    """Test errors of another surrogate by training-set size, drawn as a line.

    Attributes:
        name: Which surrogate.
        n_train: Training-set sizes, rising. Shape (s,).
        mae: Shape (s,). [output unit, differences]
        p90: 90th percentile of the absolute errors. Shape (s,). [output unit, differences]
    """

    name: str
    n_train: IntArray
    mae: FloatArray
    p90: FloatArray


@dataclass(frozen=True)
class TunedSize:
    """What tuning came to for one training-set size; as JSON values it is what programs read.

    Attributes:
        label: Label of the study.
        case: Name of the case.
        n_train: Size of the training set.
        study: Name of the Optuna study.
        surrogate: Named form of the surrogate.
        is_baseline: Whether it is the PCA + GP that is fitted for comparison.
        unit: Of the errors.
        n_planned: Trials the study shall have.
        n_trials: Trials that have ended: complete, pruned and failed ones.
        n_complete: Trials trained to their end.
        n_pruned: Trials stopped early.
        n_failed: Trials that failed.
        n_running: Trials that run now.
        n_waiting: Trials that wait.
        n_proposed: Trials that the sampler proposed from results.
        wall_s: Training time of all trials together. [s]
        to_go_s: Training time of the trials to come, on one core; None before the first trial. [s]
        gain: Part of the default configuration's validation MAE that tuning took away; None if unknown. [1]
        trial: Number of the best trial; None without a complete one, as all that follows.
        run_id: MLflow's run of the best trial.
        model_uri: Address by which MLflow loads the best surrogate; None for a baseline, too.
        params: Hyperparameters of the best trial.
        mae: Test MAE of the best trial. [unit]
        p90: 90th percentile of its absolute test errors. [unit]
        metrics: All errors of the best trial by name. [unit]
        baseline: Errors of PCA + GP on the same sets by name; empty without. [unit]
    """

    label: str
    case: str
    n_train: int
    study: str
    surrogate: str
    is_baseline: bool
    unit: str
    n_planned: int
    n_trials: int
    n_complete: int
    n_pruned: int
    n_failed: int
    n_running: int
    n_waiting: int
    n_proposed: int
    wall_s: float
    to_go_s: float | None
    gain: float | None
    trial: int | None = None
    run_id: str | None = None
    model_uri: str | None = None
    params: Mapping[str, Any] = field(default_factory=dict)
    mae: float | None = None
    p90: float | None = None
    metrics: Mapping[str, float] = field(default_factory=dict)
    baseline: Mapping[str, float] = field(default_factory=dict)

    @property
    def n_all(self) -> int:
        """Trials that it has or shall have."""
        return max(self.n_planned, self.n_trials + self.n_running + self.n_waiting)
