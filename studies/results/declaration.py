"""What decides the trials of a study, kept as an attribute of the Optuna study itself.

Any worker, on any machine of the project, can go on with a study from its name alone.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

import numpy as np

from pelsvae.config import SurrogateConfig
from simulation.arrays import digest_of
from simulation.errors import InputError
from studies.paths import ProjectPaths, size_name
from studies.results.saved import plain
from studies.search_space import STRICT, OwnConfig, SearchParameter, SearchSpace, default_point, is_own

ALIAS = "champion"
"""Of the best surrogate of a size, in MLflow's registry."""
UNEXPLAINED = "/unexplained"
"""Last part of the names of errors that are a part of the variance, without a unit."""
SETS = ("train", "validation", "test")
CROSS_VALIDATED = "cv"
"""First part of the names of errors that were found by cross-validation."""
DRIVE = "drive"
"""Of the file with what drives the model."""
_ERRORS = ("val/", "test/", f"{CROSS_VALIDATED}/")


def digest_of_arrays(arrays: Mapping[str, Any]) -> str:
    """Return a digest of arrays by name."""
    return digest_of(*(part for name in sorted(arrays) for part in (name, np.asarray(arrays[name]))))


@dataclass(frozen=True, kw_only=True)
class StudyDeclaration:
    """What every Optuna study is declared with, whatever its trials do.

    Args:
        label: what the user calls it; MLflow's experiment.
        sampler: Optuna's sampler: its name and arguments.
        pruner: the pruner: its name and arguments.
        seed: every random draw of the study derives from it and the training-set size.
        n_train: rows of the training design that are used (failed simulations among them are left out); 0
            where there is none.
        enqueue: configurations that are tried first.
        max_trial_s: longest trial; one that reaches it counts as pruned. Decides nothing else. [s]
        note: shown where the numbers are shown.
        project: identity of the project whose study it is in a database that others share; else empty.
    """

    __pydantic_config__ = STRICT
    step_word: ClassVar[str] = "step"
    maximize: tuple[str, ...] = ()
    is_curve: ClassVar[bool] = True
    """Whether MLflow shows what its trials report; else they write curves of their own."""

    label: str
    sampler: dict[str, Any]
    pruner: dict[str, Any]
    seed: int
    n_train: int = 0
    enqueue: tuple[dict[str, Any], ...] = ()
    max_trial_s: float | None = None
    note: str = ""
    project: str = ""

    @property
    def name(self) -> str:
        """Name of the Optuna study."""
        raise NotImplementedError

    @property
    def size(self) -> str:
        """What its runs are called."""
        return self.label

    @property
    def role(self) -> str:
        """What its trials are called in MLflow."""
        return "trial"

    @property
    def study_role(self) -> str:
        """What its own run is called in MLflow."""
        return "study"

    @property
    def seed_use(self) -> int:
        """What its trials use their seeds for, see `trial_seed`."""
        return 1

    @property
    def about(self) -> dict[str, Any]:
        """What MLflow shows of each of its trials."""
        return {"n_train": self.n_train} if self.n_train else {}

    @property
    def value_names(self) -> tuple[str, ...]:
        """Names of what a trial returns, as in MLflow."""
        raise NotImplementedError

    @property
    def first_points(self) -> list[dict[str, Any]]:
        """The configurations that are tried first."""
        return [*self.enqueue]

    def results_of(
        self, state: str, values: Sequence[float] | None, attrs: Mapping[str, Any]
    ) -> dict[str, float]:
        """Return what a trial came to by name; nothing where it has come to nothing.

        Args:
            state: its state, as in `TrialView`.
            values: what it returned, or reported last. Length m.
            attrs: attributes that its worker gave it.
        """
        return dict(zip(self.value_names, values or (), strict=False)) if state == "complete" else {}

    def trial_seed(self, place: int, use: int) -> int:
        """Return the seed of a trial.

        Args:
            place: the trial's place in the study; a retry has that of the trial it repeats.
            use: 0 for the sampler, 1 for the trial, 2 for a training that confirms another one.
        """
        # Hashed, not added: sums of seed and place would give two trials one stream.
        return int(np.random.SeedSequence([self.seed, self.n_train, place, use]).generate_state(1)[0])

    def to_dict(self) -> dict[str, Any]:
        """Return the declaration as JSON values."""
        return plain(self)


@dataclass(frozen=True, kw_only=True)
class Declaration(StudyDeclaration):
    """One Optuna study: the surrogate of one case for one training-set size.

    Args:
        n_train: rows of the training design that are used (failed simulations among them are left out).
        case_name: name of the case.
        surrogate: named form of the surrogate: "state-space", "refined", "paper" or "pca-gp"; or a user's
            class as "module:Class".
        settings: settings of the surrogate that every trial shares.
        forms: where the decoder is searched, the settings that trials with each decoder share.
        search: search space, as JSON values by hyperparameter.
        parameter_names: physical parameters, in the order of the sets' columns. Length p.
        lower: their lower bounds. Length p.
        upper: their upper bounds. Length p.
        is_log: whether each is logarithmic. Length p.
        output_names: simulated outputs. Length k.
        output_unit: unit of the first output and so of the errors.
        output_scales: what an error of each output is multiplied with to be comparable with the first
            output's. Length k. [first output's unit / output's unit]
        files: place of the training, validation and test set, relative to the project; and of what drives the
            model ("drive"), where a decoder needs it.
        digests: SHA-256 of case, FMU, the three sets, and of what drives the model.
        device: where the surrogate is trained; decides no trial.
        is_baseline: whether it is the PCA + GP that is fitted for comparison.
        is_confirmation: whether its trials train configurations of another study with further seeds.
        folds: parts of the training rows that judge in turn; 0 where a validation and a test set do.
    """

    step_word: ClassVar[str] = "epoch"
    is_curve: ClassVar[bool] = False

    n_train: int
    case_name: str
    surrogate: str
    settings: dict[str, Any]
    search: dict[str, dict[str, Any]]
    parameter_names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    is_log: tuple[bool, ...]
    output_names: tuple[str, ...]
    output_unit: str
    output_scales: tuple[float, ...]
    files: dict[str, str]
    digests: dict[str, str]
    forms: dict[str, dict[str, Any]] = field(default_factory=dict)
    device: str = "auto"
    is_baseline: bool = False
    is_confirmation: bool = False
    folds: int = 0

    @cached_property
    def digest(self) -> str:
        """SHA-256 over all that decides the trials and their errors."""
        # What changes no trial is left out: another label or place of the files must not begin a new study.
        idle = ("label", "case_name", "files", "enqueue", "device", "max_trial_s", "note")
        idle += ("is_baseline", "is_confirmation")
        # Studies of before decoders were searched, and of projects that share nothing, keep their names.
        added = ("forms", "project", "folds")
        decisive = {
            name: value
            for name, value in self.to_dict().items()
            if name not in idle and (name not in added or value)
        }
        return digest_of(json.dumps(decisive, sort_keys=True))

    @cached_property
    def name(self) -> str:
        """Name of the Optuna study, for example `office-quick/n0064/1a2b3c4d`."""
        kind = "-pca-gp" if self.is_baseline else "-confirm" if self.is_confirmation else ""
        return f"{self.label}/{size_name(self.n_train)}{kind}/{self.digest[:8]}"

    @property
    def size(self) -> str:
        """What runs and models of this study are called, for example `n0064`."""
        kind = " PCA + GP" if self.is_baseline else " confirmation" if self.is_confirmation else ""
        return size_name(self.n_train) + kind

    @property
    def role(self) -> Literal["trial", "baseline trial", "confirmation"]:
        """What its trials are called in MLflow: the least error of all trials is no baseline's."""
        return "confirmation" if self.is_confirmation else "baseline trial" if self.is_baseline else "trial"

    @property
    def study_role(self) -> str:
        """What its own run is called in MLflow."""
        return f"{'baseline ' if self.is_baseline else 'confirmation ' if self.is_confirmation else ''}study"

    @property
    def seed_use(self) -> int:
        """Other seeds where another study is confirmed."""
        return 2 if self.is_confirmation else 1

    @property
    def value_names(self) -> tuple[str, ...]:
        """Name of the error that chooses, as in MLflow."""
        return (f"{self.chosen_by}/mae",)

    def results_of(
        self, state: str, values: Sequence[float] | None, attrs: Mapping[str, Any]
    ) -> dict[str, float]:
        """Return a trial's errors by name, as `val/mae` and `test/p90`; with cross-validation as `cv/mae`.

        There are none unless it is complete or pruned. A pruned trial has no `val/mae`, so that the least one
        is a complete trial's; the others are those of its best epoch.
        """
        if state not in ("complete", "pruned") or not values:
            return {}
        errors = {name: float(v) for name, v in attrs.items() if name.startswith(_ERRORS)}
        chosen_by = CROSS_VALIDATED if f"{CROSS_VALIDATED}/p90" in errors else "val"
        return {f"{chosen_by}/mae": float(values[0]), **errors} if state == "complete" else errors

    @property
    def confirmation(self) -> "Declaration":
        """The study that trains configurations of this one with further seeds."""
        # Every trial of it is given, and trained to its end.
        sampler, pruner = {"name": "RandomSampler"}, {"name": "NopPruner"}
        return replace(self, is_confirmation=True, enqueue=(), sampler=sampler, pruner=pruner)

    @property
    def data(self) -> tuple[Any, ...]:
        """What two studies share whose errors are compared: label, data sets, folds, what errors weigh."""
        digests = sorted(one for one in self.digests.items() if one[0] != DRIVE)
        return self.label, self.n_train, self.output_scales, self.folds, *digests

    def has_equal_data(self, other: "Declaration") -> bool:
        """Say whether errors of two studies compare and neither is the other's baseline."""
        return (self.is_baseline, self.data) == (other.is_baseline, other.data)

    @property
    def sets(self) -> tuple[str, ...]:
        """The sets that its trials need."""
        return SETS[:1] if self.folds else SETS

    @property
    def chosen_by(self) -> str:
        """First part of the names of the errors that choose the best trial."""
        return CROSS_VALIDATED if self.folds else "val"

    @property
    def judged_by(self) -> str:
        """First part of the names of the errors that are shown of it."""
        return CROSS_VALIDATED if self.folds else "test"

    @property
    def model_name(self) -> str:
        """Name of the best surrogate in MLflow's registry."""
        return f"{self.label}-{size_name(self.n_train)}" + (f"-{self.project[:6]}" if self.project else "")

    @property
    def model_uri(self) -> str:
        """Address by which MLflow loads the best surrogate."""
        return f"models:/{self.model_name}@{ALIAS}"

    @cached_property
    def base_config(self) -> SurrogateConfig:
        """The settings that all trials share."""
        if is_own(self.surrogate):  # which stand for settings wherever trials are compared and shown
            return cast("SurrogateConfig", OwnConfig(self.surrogate).replace(**self.settings))
        # One thread each, as the workers share the cores.
        return SurrogateConfig.from_dict(self.settings | {"device": self.device, "n_threads": 1})

    @cached_property
    def space(self) -> SearchSpace:
        """The search space."""
        return {name: SearchParameter(**declared) for name, declared in self.search.items()}

    @property
    def first_points(self) -> list[dict[str, Any]]:
        """The configurations that are tried first: the surrogate's own, then those of the profile."""
        if self.is_confirmation:
            return []
        bases = [self._base_of(name) for name in self.forms or (None,)]
        if (states := self.space.get("states")) is not None:
            bases += [one.replace(states=name) for name in states.choices[1:] for one in bases[:1]]
        defaults = [default_point(self.space, base) for base in bases]
        return [*defaults, *(defaults[0] | dict(point) for point in self.enqueue)]

    def config(self, params: Mapping[str, Any]) -> SurrogateConfig:
        """Return all settings of a trial's surrogate."""
        is_adam = params.get("optimizer") == "adam" and not is_own(self.surrogate)
        plain = {"weight_decay": 0.0} if is_adam else {}  # adam has none
        return self._base_of(params.get("decoder")).replace(**(plain | dict(params)))

    def point_of(self, config: SurrogateConfig) -> dict[str, Any] | None:
        """Return the hyperparameters by which a trial would have these settings, None where none has them."""
        point: dict[str, Any] = {}
        if type(config) is not type(self.base_config):
            return None
        for name, parameter in self.space.items():
            if parameter.is_asked(self.base_config.to_dict() | point):
                point[name] = getattr(config, name)
        try:
            is_inside = all(self.space[name].has(value) for name, value in point.items())
            return point if is_inside and self.config(point) == config else None
        except ValueError:  # settings that do not go together
            return None

    def continues(self, other: "Declaration") -> bool:
        """Say whether trials of another study, with the same settings, would be trials of this one, too."""
        same = ("is_confirmation", "sampler", "pruner", "seed", "project")
        are_alike = all(getattr(self, name) == getattr(other, name) for name in same)
        return are_alike and self.has_equal_data(other) and self.name != other.name

    def _base_of(self, decoder: str | None) -> SurrogateConfig:
        """Return the settings that trials with a decoder share."""
        if decoder not in self.forms:
            return self.base_config
        return SurrogateConfig.from_dict(self.forms[decoder] | {"device": self.device, "n_threads": 1})

    def file(self, paths: ProjectPaths, name: str) -> Path:
        """Return where a set lies.

        Raises:
            InputError: the declared place lies outside the project.
        """
        file = (paths.root / self.files[name]).resolve()
        # Resolved on both sides, as a link may lead outside too; a declaration may be another program's.
        if not file.is_relative_to(paths.root.resolve()):
            raise InputError(f"study {self.name!r}: {self.files[name]!r} lies outside the project")
        return file
