"""What Fig. 6 is drawn from: every trial of a training-set size, one JSON file per size."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from studies.paper.size_files import Origin, read_sizes
from studies.tuning.results import TrialView, TunedStudy


@dataclass(frozen=True)
class Trial:
    """One trial that has ended.

    Args:
        number: Optuna's number of the trial.
        state: "complete", "pruned" or "failed".
        proposed_by: "default", "profile", "start-up" or the sampler's name.
        params: its hyperparameters.
        val_mae: validation MAE; of a pruned trial the last one reported. [output's unit]
        val_p90: 90th percentile on the validation set, of a complete trial. [output's unit]
        test_mae: test MAE of a complete trial. [output's unit]
        test_p90: 90th percentile on the test set, of a complete trial. [output's unit]
        n_epochs: epochs trained.
        best_epoch: epoch whose weights were kept; 0 unless complete.
        wall_s: duration of the training. [s]
    """

    number: int
    state: str
    proposed_by: str
    params: dict[str, float | int | str | bool]
    val_mae: float | None
    val_p90: float | None
    test_mae: float | None
    test_p90: float | None
    n_epochs: int
    best_epoch: int
    wall_s: float


@dataclass(frozen=True)
class Tuning:
    """An Optuna study: one form of the surrogate, one training-set size.

    Args:
        surrogate: the form, for example "refined".
        study: name of the Optuna study; its end is the digest of all that decides the trials.
        n_planned: trials it shall have.
        settings: settings that its trials share, where a trial has no other.
        search: search space, as JSON values by hyperparameter.
        sampler: Optuna's sampler: its name and arguments.
        pruner: the pruner: its name and arguments.
        trials: its trials that have ended.
    """

    surrogate: str
    study: str
    n_planned: int
    settings: dict[str, Any]
    search: dict[str, dict[str, Any]]
    sampler: dict[str, Any]
    pruner: dict[str, Any]
    trials: tuple[Trial, ...]

    @cached_property
    def complete(self) -> tuple[Trial, ...]:
        """Trials that were trained to their end; they have all errors."""
        return tuple(trial for trial in self.trials if trial.state == "complete")

    @property
    def judged(self) -> tuple[Trial, ...]:
        """Trials with hyperparameters and a validation error; a pruned one has its last."""
        return tuple(trial for trial in self.trials if trial.val_mae is not None and trial.params)

    @property
    def best(self) -> Trial:
        """The complete trial of least validation error."""
        return min(self.complete, key=lambda trial: (known(trial.val_mae), trial.number))

    @property
    def default(self) -> Trial | None:
        """The trial with the surrogate's own settings, where it was trained to its end."""
        return next((trial for trial in self.complete if trial.proposed_by == "default"), None)

    @property
    def n_proposed(self) -> int:
        """Trials that the sampler proposed from results."""
        return sum(trial.proposed_by.endswith("Sampler") for trial in self.trials)

    def setting(self, trial: Trial, name: str) -> float:
        """Return a setting of a trial's surrogate."""
        return float({**self.settings, **trial.params}[name])


@dataclass(frozen=True)
class SizeTrials:
    """All trials of one training-set size.

    Args:
        n_train: training-set size.
        mean_predictor_mae: test error of predicting the training set's mean trajectory. [output's unit]
        networks: the surrogate of the profile.
        faithful: the form of the paper beside it, None without.
        pca_gp: PCA + GP, fitted once, None without.
    """

    n_train: int
    mean_predictor_mae: float
    networks: Tuning
    faithful: Tuning | None
    pca_gp: Tuning | None


def known(error: float | None) -> float:
    """Return an error that a complete trial has, infinity where there is none."""
    return float("inf") if error is None else error


def tuning_of(study: TunedStudy | None) -> Tuning | None:
    """Return what Fig. 6 needs of a study, None where no trial of it was completed."""
    if study is None or study.best is None:
        return None
    spec = study.spec
    # A complete trial without a run was added by hand and has no errors on the test set.
    ended = [trial for trial in study.trials if trial.state in ("complete", "pruned", "failed")]
    ours = [trial for trial in ended if trial.run_id or trial.state != "complete"]
    return Tuning(
        surrogate=spec.surrogate,
        study=spec.name,
        n_planned=study.n_planned,
        settings=spec.settings,
        search=spec.search,
        sampler=spec.sampler,
        pruner=spec.pruner,
        trials=tuple(map(_trial, ours)),
    )


def read_trials(folder: Path) -> tuple[Origin, tuple[SizeTrials, ...]]:
    """Read the trials of all sizes of a folder, the smallest size first.

    Raises:
        InputError: there is none, one cannot be read, or they belong to different studies.
    """
    return read_sizes(folder, "trials of Fig. 6", _size)


def _size(content: dict[str, Any]) -> SizeTrials:
    tunings = {name: _tuning(content[name]) for name in ("networks", "faithful", "pca_gp")}
    return SizeTrials(**{**content, **tunings})


def _tuning(content: dict[str, Any] | None) -> Tuning | None:
    if content is None:
        return None
    return Tuning(**{**content, "trials": tuple(Trial(**trial) for trial in content["trials"])})


def _trial(trial: TrialView) -> Trial:
    return Trial(
        number=trial.number,
        state=trial.state,
        proposed_by=trial.proposed_by,
        params=dict(trial.params),
        val_mae=trial.value,
        val_p90=trial.metrics.get("val/p90"),
        test_mae=trial.metrics.get("test/mae"),
        test_p90=trial.metrics.get("test/p90"),
        n_epochs=trial.n_epochs,
        best_epoch=trial.best_epoch,
        wall_s=round(trial.wall_s, 1),
    )
