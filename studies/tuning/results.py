"""What the studies of a project have come to, read from Optuna alone: for tables, figures and programs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import optuna
from optuna.trial import FrozenTrial, TrialState

from studies.paths import ProjectPaths
from studies.tuning.declaration import Declaration
from studies.tuning.storage import (
    DECLARATION,
    PLANNED,
    RUN_ID,
    declaration_of,
    errors_of,
    places,
    storage_of,
)

State = Literal["complete", "pruned", "failed", "running", "waiting"]
_STATES: dict[TrialState, State] = {
    TrialState.COMPLETE: "complete",
    TrialState.PRUNED: "pruned",
    TrialState.FAIL: "failed",
    TrialState.RUNNING: "running",
    TrialState.WAITING: "waiting",
}


@dataclass(frozen=True)
class TrialView:
    """One place of a study: a trial, or the latest retry of it.

    Args:
        number: Optuna's number of the trial.
        place: its place in the study, from 0.
        state: how it stands.
        params: its hyperparameters.
        settings: all settings of its surrogate; empty where it has no hyperparameters yet.
        value: validation MAE; of a pruned trial the last one reported. [output's unit]
        metrics: errors by name; empty unless the trial is complete. [output's unit]
        reports: validation MAE by epoch, where trials are compared. [output's unit]
        run_id: MLflow's run, empty without one.
        proposed_by: "default", "profile", "start-up" or the sampler's name.
        reason: why it ended.
        wall_s: duration of the training. [s]
        n_epochs: epochs trained.
        best_epoch: epoch whose weights were kept.
        seed: seed of the training.
        began_s: when it began. [s since 1970, UTC]
        weights_sha256: of the trained surrogate's weights.
    """

    number: int
    place: int
    state: State
    params: Mapping[str, Any]
    settings: Mapping[str, Any]
    value: float | None
    metrics: Mapping[str, float]
    reports: Mapping[int, float]
    run_id: str
    proposed_by: str
    reason: str
    wall_s: float
    n_epochs: int
    best_epoch: int
    seed: int
    began_s: float
    weights_sha256: str


@dataclass(frozen=True)
class TunedStudy:
    """An Optuna study of this project.

    Args:
        spec: what it was declared with.
        n_planned: trials it shall have.
        trials: its places, in order.
        run_id: MLflow's run of the study, empty without one.
    """

    spec: Declaration
    n_planned: int
    trials: tuple[TrialView, ...]
    run_id: str = ""

    def count(self, state: State) -> int:
        """Return the number of trials in a state."""
        return sum(trial.state == state for trial in self.trials)

    @property
    def n_ended(self) -> int:
        """Trials that have ended."""
        return self.count("complete") + self.count("pruned") + self.count("failed")

    @cached_property
    def best(self) -> TrialView | None:
        """The completed trial of least validation error among those that were trained here."""
        ours = [trial for trial in self.trials if trial.state == "complete" and trial.run_id]
        return min(ours, key=lambda trial: (trial.value, trial.number), default=None)

    @property
    def default(self) -> TrialView | None:
        """The trial with the surrogate's own settings, where it was trained to its end."""
        found = (t for t in self.trials if t.proposed_by == "default" and t.state == "complete")
        return next(found, None)

    @property
    def gain(self) -> float | None:
        """Part of the default configuration's validation error that tuning took away."""
        if self.best is None or self.default is None or not self.default.value or self.best.value is None:
            return None
        return 1.0 - self.best.value / self.default.value

    @property
    def wall_s(self) -> float:
        """Training time of all trials together. [s]."""
        return sum(trial.wall_s for trial in self.trials)

    @property
    def to_go_s(self) -> float | None:
        """Training time of the trials to come, on one core; None before the first trial. [s]."""
        n_left, n_timed = max(self.n_planned - self.n_ended, 0), sum(t.wall_s > 0.0 for t in self.trials)
        return 0.0 if not n_left else n_left * self.wall_s / n_timed if n_timed else None

    @property
    def n_proposed(self) -> int:
        """Trials that the sampler proposed from results."""
        return sum(trial.proposed_by.endswith("Sampler") for trial in self.trials)

    @property
    def began_s(self) -> float:
        """When its first trial began. [s since 1970, UTC]."""
        return min((trial.began_s for trial in self.trials if trial.began_s), default=0.0)


def read_study(study: optuna.Study) -> TunedStudy:
    """Read a study.

    Raises:
        InputError: it was made by another program or version.
    """
    spec, attrs = declaration_of(study), study.user_attrs
    trials = places(study.get_trials(deepcopy=False))
    return TunedStudy(
        spec=spec,
        n_planned=int(attrs.get(PLANNED, 0)),
        trials=tuple(_view(spec, trial, place) for place, trial in enumerate(trials)),
        run_id=str(attrs.get(RUN_ID, "")),
    )


def read_studies(paths: ProjectPaths, *, label: str | None = None) -> list[TunedStudy]:
    """Read the studies of a project, by label and size; those of other programs are left out.

    Args:
        paths: the project.
        label: only those of a label.
    """
    if paths.storage is None and not paths.optuna_database.is_file():
        return []
    found = []
    with storage_of(paths) as storage:
        for study in storage.get_all_studies():  # Optuna's summaries would read all trials once more
            declared = study.user_attrs.get(DECLARATION)
            if isinstance(declared, dict) and label in (None, declared.get("label")):
                found.append(read_study(optuna.load_study(study_name=study.study_name, storage=storage)))
    return sorted(
        found, key=lambda one: (one.spec.label, one.spec.n_train, one.spec.is_baseline, one.began_s)
    )


def latest_studies(
    studies: Sequence[TunedStudy], case_digest: str | None = None
) -> dict[tuple[int, bool], TunedStudy]:
    """Return the study begun last of each size, by size and whether it is the baseline.

    Args:
        studies: studies of one label.
        case_digest: only those of this physics.
    """
    mine = [s for s in studies if case_digest in (None, s.spec.digests.get("case"))]
    return {
        (one.spec.n_train, one.spec.is_baseline): one for one in sorted(mine, key=lambda one: one.began_s)
    }


def _view(spec: Declaration, trial: FrozenTrial, place: int) -> TrialView:
    training = trial.user_attrs.get("training", {})
    began = trial.datetime_start.timestamp() if trial.datetime_start else 0.0
    ended = trial.datetime_complete.timestamp() if trial.datetime_complete else 0.0
    params = dict(trial.params)
    known = {name: value for name, value in params.items() if name in spec.settings}
    usual = "" if trial.state == TrialState.WAITING else "start-up"
    return TrialView(
        number=trial.number,
        place=place,
        state=_STATES[trial.state],
        params=params,
        settings={**spec.settings, **known} if known or not spec.space else {},
        value=None if trial.value is None else float(trial.value),
        metrics=errors_of(trial) if trial.state == TrialState.COMPLETE else {},
        reports={int(step): float(value) for step, value in trial.intermediate_values.items()},
        run_id=str(trial.user_attrs.get(RUN_ID, "")),
        proposed_by=str(trial.user_attrs.get("proposed_by", usual)),
        reason=str(trial.user_attrs.get("reason", "")),
        wall_s=float(training.get("wall_s", max(ended - began, 0.0) if ended else 0.0)),
        n_epochs=int(training.get("n_epochs", trial.last_step or 0)),
        best_epoch=int(training.get("best_epoch", 0)),
        seed=int(trial.user_attrs.get("seed", 0)),
        began_s=began,
        weights_sha256=str(training.get("weights_sha256", "")),
    )
