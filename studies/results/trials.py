"""Trials of the tuning and what a study of them has come to."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from studies.results.declaration import Declaration
from studies.results.stage_results import TunedSize
from studies.words.wording import difference_unit

STATES = ("complete", "pruned", "failed", "running", "waiting")


@dataclass(frozen=True)
class TrialView:
    """One place of a study: a trial, or the latest retry of it.

    Args:
        number: Optuna's number of the trial.
        state: "complete", "pruned", "failed", "running" or "waiting".
        params: its hyperparameters.
        value: validation MAE; of a trial that is not complete the last one reported. [output's unit]
        metrics: errors by name, see `errors_of`. [output's unit]
        run_id: MLflow's run, empty without one.
        proposed_by: "default", "profile", "start-up" or the sampler's name.
        wall_s: duration of the training. [s]
        n_epochs: epochs trained.
        best_epoch: epoch whose weights were kept.
        began_s: when it began. [s since 1970, UTC]
        weights_sha256: of the trained surrogate's weights.
        reported: validation MAE by epoch, where trials are compared. [output's unit]
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
    reported: Mapping[int, float] = field(default_factory=dict)


@dataclass(frozen=True)
class TunedStudy:
    """An Optuna study of this project.

    Args:
        spec: what it was declared with.
        n_planned: trials it shall have.
        trials: its places, in order.
        n_closed: trials it had when its best surrogate was registered; 0 before.
        gone: runs that cannot be recommended: deleted by their owner, or second to one and without weights.
    """

    spec: Declaration
    n_planned: int
    trials: tuple[TrialView, ...]
    n_closed: int = 0
    gone: frozenset[str] = frozenset()

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
        ours = [trial for trial in ours if trial.run_id not in self.gone]
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
    def trials_per_h(self) -> float | None:
        """Trials trained here per hour of training; None before the first one. [1/h]."""
        # What a person added through Optuna took no time here.
        ours = [trial for trial in self.trials if trial.run_id and trial.wall_s > 0.0]
        return 3600.0 * len(ours) / sum(trial.wall_s for trial in ours) if ours else None

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
            trials_per_h=self.trials_per_h,
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


def errors_of(state: str, value: float | None, attrs: Mapping[str, Any]) -> dict[str, float]:
    """Return a trial's errors by name, as `val/mae` and `test/p90`; none unless it is complete or pruned.

    A pruned trial has no `val/mae`, so that the least one is a complete trial's; the others are those of its
    best epoch.

    Args:
        state: its state, as in `TrialView`.
        value: its value, the validation MAE. [output's unit]
        attrs: attributes that its worker gave it.
    """
    if state not in ("complete", "pruned") or value is None:
        return {}
    errors = {name: float(v) for name, v in attrs.items() if name.startswith(("val/", "test/"))}
    return {"val/mae": float(value), **errors} if state == "complete" else errors
