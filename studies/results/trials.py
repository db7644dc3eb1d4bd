"""Trials of the tuning and what a study of them has come to."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import hypot
from statistics import fmean, stdev
from typing import Any

from pelsvae.config import SurrogateConfig
from studies.results.best_mean import BestMean, MeanPart, in_words
from studies.results.declaration import Declaration
from studies.results.stage_results import TunedSize
from studies.words.wording import difference_unit

STATES = ("complete", "pruned", "failed", "running", "waiting")


@dataclass(frozen=True)
class TrialView:
    """One place of a study: a trial, or the latest retry of it.

    Args:
        spec: the study that it is of.
        number: Optuna's number of the trial.
        state: "complete", "pruned", "failed", "running" or "waiting".
        params: its hyperparameters.
        value: validation MAE; of a trial that is not complete the last one reported. [output's unit]
        metrics: errors by name, see `Declaration.results_of`. [output's unit]
        run_id: MLflow's run, empty without one.
        proposed_by: "default", "profile", "start-up" or the sampler's name.
        wall_s: duration of the training. [s]
        n_epochs: epochs trained.
        best_epoch: epoch whose weights were kept.
        weights_sha256: of the trained surrogate's weights.
        parts: what a mean is made of, whose leading trial this is then; none of a trial alone.
        reported: validation MAE by epoch, where trials are compared. [output's unit]
        carried_from: the trial of an earlier study that it is, where the search space was edited; else empty.
    """

    spec: Declaration
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
    weights_sha256: str
    parts: tuple[MeanPart, ...] = ()
    reported: Mapping[int, float] = field(default_factory=dict)
    carried_from: str = ""

    @property
    def model(self) -> str:
        """What it is, in words."""
        further = " of further seeds" if self.spec.is_confirmation else ""
        return in_words(self.parts) if self.parts else f"trial {self.number}{further}"

    @property
    def has_ended(self) -> bool:
        """Whether it is over, with whatever result."""
        return self.state in ("complete", "pruned", "failed")

    @cached_property
    def settings(self) -> SurrogateConfig:
        """All settings of its surrogate; trainings with equal ones differ in their seed alone."""
        return self.spec.config(self.params)


@dataclass(frozen=True)
class TunedStudy:
    """An Optuna study of this project, or several whose errors compare (see `joined`).

    Args:
        spec: what it was declared with.
        number: Optuna's number of it; a later one has a larger one, whatever a clock says.
        n_planned: trials it shall have.
        trials: its places, in order.
        n_closed: trials that had ended when its best surrogate was registered; 0 before.
        gone: runs that cannot be recommended: deleted by their owner, or second to one and without weights.
        versions: versions of registered models, by run.
        mean: the best mean of its surrogates; None where none was looked for.
        repeated: trials of one study that were carried over from another one, whose `trials` they are.
    """

    spec: Declaration
    number: int
    n_planned: int
    trials: tuple[TrialView, ...]
    n_closed: int = 0
    gone: frozenset[str] = frozenset()
    versions: Mapping[str, int] = field(default_factory=dict)
    mean: BestMean | None = None
    repeated: tuple[TrialView, ...] = ()

    def count(self, state: str) -> int:
        """Return the number of trials in a state."""
        return sum(trial.state == state for trial in self.proposals)

    @property
    def proposals(self) -> list[TrialView]:
        """Its trials without those that confirm others."""
        return [one for one in self.trials if one.spec.is_confirmation == self.spec.is_confirmation]

    @property
    def n_ended(self) -> int:
        """Trials that have ended, without those that confirm others."""
        return self.count("complete") + self.count("pruned") + self.count("failed")

    @property
    def is_closed(self) -> bool:
        """Whether all trials have ended and the best one of them was registered."""
        n_ended = sum(one.has_ended for one in self.trials)
        # Projects of before noted no version, and their best one was chosen of the latest study alone.
        is_registered = self.best is None or self.spec.is_baseline or self.best.run_id in self.versions
        return is_registered and self.n_closed == n_ended == len(self.trials)

    @cached_property
    def usable(self) -> list[TrialView]:
        """The completed trials that were trained here, the least error first."""
        # Trials that users add through Optuna have no run, and so no weights to register.
        ours = [trial for trial in self.trials if trial.state == "complete" and trial.run_id]
        # Of equal errors the earlier trial, so that reading again finds the same one.
        return sorted((one for one in ours if one.run_id not in self.gone), key=lambda one: one.value or 0.0)

    @cached_property
    def confirmed(self) -> dict[SurrogateConfig, tuple[float, ...]]:
        """Errors of further seeds by settings; they were not chosen, so their mean is no lucky one."""
        found: dict[SurrogateConfig, tuple[float, ...]] = {}
        for one in self.usable:
            if one.spec.is_confirmation:
                found[one.settings] = (*found.get(one.settings, ()), one.value or 0.0)
        return found

    @cached_property
    def best(self) -> TrialView | None:
        """The best trial, or the mean of several where it is worth it.

        The alias, the tag, tables, the report and calibrations all ask here.
        """
        trial, mean = self.best_trial, self.mean
        if trial is None or mean is None or mean.run_id in self.gone:
            return trial
        if not mean.is_worth_it(trial.value or 0.0):
            return trial
        return replace(
            trial,
            params=trial.params if trial.run_id in [one.run_id for one in mean.parts] else {},
            value=mean.metrics["val/mae"],
            metrics=mean.metrics,
            run_id=mean.run_id,
            weights_sha256=mean.weights_sha256,
            parts=mean.parts,
        )

    @cached_property
    def best_trial(self) -> TrialView | None:
        """The completed trial of least validation error; of confirmed settings, those of least mean error."""
        means = {settings: fmean(errors) for settings, errors in self.confirmed.items()}
        chosen = min(means, key=lambda one: means[one], default=None)
        return next((one for one in self.usable if chosen in (None, one.settings)), None)

    @property
    def default(self) -> TrialView | None:
        """The trial with the surrogate's own settings, where it was trained to its end."""
        every = (*self.trials, *self.repeated)
        found = [one for one in every if one.proposed_by == "default" and one.state == "complete"]
        # Of several studies that of the best trial: another search space may have another default.
        first = next((one.spec.name for one in self.usable if not one.spec.is_confirmation), "")
        return next(iter([one for one in found if one.spec.name == first] or found), None)

    @property
    def gain(self) -> float | None:
        """Part of the default configuration's error that tuning took away; of means where confirmed."""
        if (seeds := self._seeds) is not None:
            return 1.0 - fmean(seeds[0]) / fmean(seeds[1])
        best, default = self.best_trial, self.default
        if best is None or default is None or not default.value or best.value is None:
            return None
        return 1.0 - best.value / default.value

    @property
    def gain_deviation(self) -> float | None:
        """Standard deviation of the gain from seed to seed, None where it was not confirmed."""
        if (seeds := self._seeds) is None or min(map(len, seeds)) < 2:
            return None
        if seeds[0] is seeds[1]:  # the default is the best
            return 0.0
        best, default = seeds
        ratio = fmean(best) / fmean(default)
        return ratio * hypot(stdev(best) / fmean(best), stdev(default) / fmean(default))

    @property
    def _seeds(self) -> tuple[tuple[float, ...], tuple[float, ...]] | None:
        """Errors of further seeds of the best and of the default settings."""
        if not self.confirmed or self.best_trial is None or self.default is None:
            return None
        best, default = (self.confirmed.get(one.settings) for one in (self.best_trial, self.default))
        return (best, default) if best and default else None

    @property
    def wall_s(self) -> float:
        """Training time of all trials together, without those that confirm others. [s]."""
        return sum(trial.wall_s for trial in self.proposals)

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
        n_left, n_timed = max(self.n_planned - self.n_ended, 0), sum(t.wall_s > 0.0 for t in self.proposals)
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
        carried = [one for one in self.of(spec.name).trials if one.carried_from]
        beside = next((o.best for o in studies if o.spec.is_baseline and o.spec.data == spec.data), None)
        more: dict[str, Any] = {f"n_{state}": self.count(state) for state in STATES}
        more |= {"study": spec.name, "surrogate": spec.surrogate}
        if best is not None:
            more |= {"trial": best.number, "run_id": best.run_id, "params": dict(best.params)}
            more |= {name: best.metrics.get(f"{spec.judged_by}/{name}") for name in ("mae", "p90")}
            more |= {"metrics": dict(best.metrics), "study": best.spec.name, "surrogate": best.spec.surrogate}
            more |= {"model": best.model, "parts": best.parts}
        return TunedSize(
            label=spec.label,
            case=spec.case_name,
            n_train=spec.n_train,
            is_baseline=spec.is_baseline,
            unit=difference_unit(spec.output_unit),
            n_planned=self.n_planned,
            n_trials=self.n_ended,
            n_proposed=self.n_proposed,
            wall_s=self.wall_s,
            trials_per_h=self.trials_per_h,
            to_go_s=self.to_go_s,
            gain=self.gain,
            gain_deviation=self.gain_deviation,
            n_seeds=0 if (seeds := self._seeds) is None else min(map(len, seeds)),
            model_uri=self.model_uri,
            baseline={} if beside is None else dict(beside.metrics),
            folds=spec.folds,
            n_carried=len(carried),
            **more,
        )

    @property
    def model_uri(self) -> str | None:
        """Address of the best surrogate in MLflow's registry, None before it is registered."""
        if self.best is None or self.spec.is_baseline:
            return None
        if (version := self.versions.get(self.best.run_id)) is not None:
            return f"models:/{self.best.spec.model_name}/{version}"
        # Projects of before noted no versions; of several studies another one may have the alias.
        is_alone = len({one.spec.name for one in self.trials}) == 1
        return self.best.spec.model_uri if self.n_closed and not self.versions and is_alone else None

    def of(self, name: str) -> "TunedStudy":
        """Return what is of one study alone."""
        own = [one for one in (*self.trials, *self.repeated) if one.spec.name == name]
        own.sort(key=lambda one: one.number)
        return replace(self, spec=own[0].spec if own else self.spec, trials=tuple(own), repeated=())

    def n_ended_of(self, name: str) -> int:
        """Return how many trials of one study have ended, without those that another one has, too."""
        return sum(one.spec.name == name and one.has_ended for one in self.trials)


def joined(studies: Sequence[TunedStudy]) -> TunedStudy:
    """Return studies whose errors compare as one: an edited search space begins another study.

    Args:
        studies: studies of equal data (see `Declaration.data`), at least one.
    """
    *others, last = sorted(studies, key=lambda one: (not one.spec.is_confirmation, one.number))
    every, first = [trial for one in (*others, last) for trial in one.trials], dict[str, TrialView]()
    # A trained surrogate counts once: as the trial that it first was.
    for trial in sorted(every, key=lambda one: bool(one.carried_from)):
        first.setdefault(trial.run_id, trial)
    kept = tuple(one for one in every if not one.carried_from or first[one.run_id] is one)
    repeated = tuple(one for one in every if one.carried_from and first[one.run_id] is not one)
    n_others = sum(not one.spec.is_confirmation and one.spec.name != last.spec.name for one in kept)
    n_new = last.n_planned - sum(one.spec.name == last.spec.name for one in repeated)
    return TunedStudy(
        spec=last.spec,
        number=last.number,
        n_planned=max(n_new, 0) + n_others,
        trials=kept,
        repeated=repeated,
        n_closed=sum(one.n_closed for one in studies),
        gone=frozenset().union(*(one.gone for one in studies)),
        versions={run: version for one in studies for run, version in one.versions.items()},
        mean=next((one.mean for one in (last, *reversed(others)) if one.mean is not None), None),
    )
