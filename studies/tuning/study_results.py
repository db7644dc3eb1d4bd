"""What the studies of a project have come to, read from Optuna alone: for tables, figures and programs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import optuna
from optuna.trial import FrozenTrial, TrialState

from studies.paths import ProjectPaths
from studies.report.wording import difference_unit
from studies.search_space import SearchSpace
from studies.stages.stage_results import TunedSize
from studies.tuning import attempts
from studies.tuning.declaration import Declaration
from studies.tuning.storage import storage_of

MIN_FOR_IMPORTANCE = 4
STATES = ("complete", "pruned", "failed", "running", "waiting")


@dataclass(frozen=True)
class TrialView:
    """One place of a study: a trial, or the latest retry of it.

    Args:
        number: Optuna's number of the trial.
        state: "complete", "pruned", "failed", "running" or "waiting".
        params: its hyperparameters.
        value: validation MAE; of a trial that is not complete the last one reported. [output's unit]
        metrics: errors by name; empty unless the trial is complete. [output's unit]
        run_id: MLflow's run, empty without one.
        proposed_by: "default", "profile", "start-up" or the sampler's name.
        wall_s: duration of the training. [s]
        n_epochs: epochs trained.
        best_epoch: epoch whose weights were kept.
        began_s: when it began. [s since 1970, UTC]
        weights_sha256: of the trained surrogate's weights.
    """

    number: int
    state: str
    params: Mapping[str, Any]
    value: float | None
    metrics: Mapping[str, float]
    run_id: str
    proposed_by: str
    wall_s: float
    n_epochs: int
    best_epoch: int
    began_s: float
    weights_sha256: str


@dataclass(frozen=True)
class TunedStudy:
    """An Optuna study of this project.

    Args:
        spec: what it was declared with.
        n_planned: trials it shall have.
        trials: its places, in order.
        n_closed: trials it had when its best surrogate was registered; 0 before.
    """

    spec: Declaration
    n_planned: int
    trials: tuple[TrialView, ...]
    n_closed: int = 0

    def count(self, state: str) -> int:
        """Return the number of trials in a state."""
        return sum(trial.state == state for trial in self.trials)

    @property
    def n_ended(self) -> int:
        """Trials that have ended."""
        return self.count("complete") + self.count("pruned") + self.count("failed")

    @cached_property
    def best(self) -> TrialView | None:
        """The completed trial of least validation error among those that were trained here."""
        # Trials that users add through Optuna have no run, and so no weights to register.
        ours = [trial for trial in self.trials if trial.state == "complete" and trial.run_id]
        # Of equal errors the earlier trial, so that reading again finds the same one.
        return min(ours, key=lambda trial: (trial.value, trial.number), default=None)

    @property
    def default(self) -> TrialView | None:
        """The trial with the surrogate's own settings, where it was trained to its end."""
        return next((t for t in self.trials if t.proposed_by == "default" and t.state == "complete"), None)

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
        # Pruned trials count with their short times, as most of those to come are pruned as well.
        n_left, n_timed = max(self.n_planned - self.n_ended, 0), sum(t.wall_s > 0.0 for t in self.trials)
        return 0.0 if not n_left else n_left * self.wall_s / n_timed if n_timed else None

    @property
    def n_proposed(self) -> int:
        """Trials that the sampler proposed from results."""
        return sum(trial.proposed_by.endswith("Sampler") for trial in self.trials)

    def summary(self, studies: "Iterable[TunedStudy]" = ()) -> TunedSize:
        """Return what it came to.

        Args:
            studies: where its PCA + GP is looked for: that of the same label and data sets.
        """
        spec, best = self.spec, self.best
        is_registered = best is not None and not spec.is_baseline
        beside = next((o.best for o in studies if o.spec.is_baseline and o.spec.data == spec.data), None)
        more: dict[str, Any] = {f"n_{state}": self.count(state) for state in STATES}
        if best is not None:
            more |= {"trial": best.number, "run_id": best.run_id, "params": dict(best.params)}
            more |= {name: best.metrics.get(f"test/{name}") for name in ("mae", "p90")}
            more |= {"metrics": dict(best.metrics)}
        return TunedSize(
            label=spec.label,
            case=spec.case_name,
            n_train=spec.n_train,
            study=spec.name,
            surrogate=spec.surrogate,
            is_baseline=spec.is_baseline,
            unit=difference_unit(spec.output_unit),
            n_planned=self.n_planned,
            n_trials=self.n_ended,
            n_proposed=self.n_proposed,
            wall_s=self.wall_s,
            to_go_s=self.to_go_s,
            gain=self.gain,
            model_uri=spec.model_uri if is_registered else None,
            baseline={} if beside is None else dict(beside.metrics),
            **more,
        )

    @property
    def began_s(self) -> float:
        """When its first trial began. [s since 1970, UTC]."""
        return min((trial.began_s for trial in self.trials if trial.began_s), default=0.0)


def read_study(study: optuna.Study) -> TunedStudy:
    """Read a study.

    Raises:
        InputError: it was made by another program or version.
    """
    attrs = study.user_attrs
    return TunedStudy(
        spec=attempts.declaration_of(study),
        n_planned=int(attrs.get(attempts.PLANNED, 0)),
        trials=tuple(map(_view, attempts.places(study.get_trials(deepcopy=False)))),
        n_closed=int(attrs.get(attempts.CLOSED, 0)),
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
            declared = study.user_attrs.get(attempts.DECLARATION)
            # The label first: to read a study means to read all its trials.
            if isinstance(declared, dict) and label in (None, declared.get("label")):
                found.append(read_study(optuna.load_study(study_name=study.study_name, storage=storage)))
    found.sort(key=lambda one: (one.spec.label, one.spec.n_train, one.spec.is_baseline, one.began_s))
    return found


def latest_studies(
    studies: Sequence[TunedStudy], case_digest: str | None = None
) -> dict[tuple[int, bool], TunedStudy]:
    """Return the study begun last of each size, by size and whether it is the baseline.

    Args:
        studies: studies of one label.
        case_digest: only those of this physics.
    """
    mine = [s for s in studies if case_digest in (None, s.spec.digests.get("case"))]
    ordered = sorted(mine, key=lambda one: one.began_s)
    # In the order of their beginning, so the last of a size remains.
    return {(one.spec.n_train, one.spec.is_baseline): one for one in ordered}


def _view(trial: FrozenTrial) -> TrialView:
    training = trial.user_attrs.get("training", {})
    began = trial.datetime_start.timestamp() if trial.datetime_start else 0.0
    ended = trial.datetime_complete.timestamp() if trial.datetime_complete else 0.0
    # A trial without a value counts by its last error.
    last = None if trial.last_step is None else trial.intermediate_values[trial.last_step]
    value = last if trial.value is None else float(trial.value)
    # The worker notes a sampler only where it proposed from results.
    usual = "" if trial.state == TrialState.WAITING else "start-up"
    return TrialView(
        number=trial.number,
        state="failed" if trial.state == TrialState.FAIL else trial.state.name.lower(),
        params=dict(trial.params),
        value=value,
        metrics=attempts.errors_of(trial),
        run_id=str(trial.user_attrs.get(attempts.RUN_ID, "")),
        proposed_by=str(trial.user_attrs.get("proposed_by", usual)),
        wall_s=float(training.get("wall_s", max(ended - began, 0.0) if ended else 0.0)),
        n_epochs=int(training.get("n_epochs", trial.last_step or 0)),
        best_epoch=int(training.get("best_epoch", 0)),
        began_s=began,
        weights_sha256=str(training.get("weights_sha256", "")),
    )


def importances(
    points: Sequence[Mapping[str, Any]], values: Sequence[float], space: SearchSpace
) -> dict[str, float]:
    """Return the part of the importance that each hyperparameter has, by Optuna's own evaluator.

    It is PED-ANOVA (Watanabe et al. 2023, arXiv:2304.10255). It compares where the best tenth of the points
    lies with where all lie. So only the order of the values counts.

    Args:
        points: hyperparameters by name.
        values: their errors, the least is the best; as many as points.
        space: the search space.

    Returns:
        Parts by name, which sum to 1, the largest first; empty with fewer than four points. [1]
    """
    if len(points) < MIN_FOR_IMPORTANCE or not space:
        return {}
    # In memory: the points of several studies and sizes are judged as one.
    study = optuna.create_study()
    for point, value in zip(points, values, strict=True):
        study.enqueue_trial(dict(point))
        trial = study.ask()
        for name, one in space.items():
            if name in point:
                one.suggest(trial, name)
        study.tell(trial, value)
    return dict(optuna.importance.get_param_importances(study))
