"""What a tuning study is given, what it reports while it runs, and what it leaves: plain, picklable data."""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pelsvae.config import VARIANTS, SurrogateConfig
from simulation.errors import InputError
from simulation.parameters import ParameterSpace
from studies.paths import size_name
from studies.search_ranges import NETWORK_RANGES, SearchRanges

TrialState = Literal["complete", "pruned", "failed"]
EventKind = Literal[
    "study-started", "trial-started", "epoch", "trial-finished", "study-finished", "waiting", "joined"
]


@dataclass(frozen=True)
class StudySpec:
    """One Optuna study: the surrogate of one case for one training-set size.

    Args:
        label: what the user calls the case and profile; MLflow's experiment.
        n_train: rows of the training design that are used (failed simulations among them are left out).
        case_name: name of the case.
        case_digest: sha256 of the physics.
        fmu_sha256: sha256 of the FMU.
        parameter_space: physical parameters; the surrogate is told which ones are logarithmic.
        output_names: simulated outputs.
        output_unit: unit of the first output and so of the errors.
        output_scales: what an error of each output is multiplied with to be comparable with the first
            output's. Length k. [first output's unit / output's unit]
        train_file: training set, at least `n_train` rows.
        validation_file: set that chooses epochs and hyperparameters.
        test_file: set that only judges.
        train_digest: sha256 of the first `n_train` rows.
        validation_digest: sha256 of the validation trajectories.
        test_digest: sha256 of the test trajectories.
        variant: named form of the surrogate the trials start from.
        overrides: settings of the surrogate that every trial shares; a None holds the variant's.
        search: ranges of the hyperparameters.
        seed: every random draw derives from it.
        n_parallel: trials that may run side by side; each knows the results of those so many places before.
        pruner: what stops trials early (see `studies.tuning.pruning`).
        objectives: errors that are minimized; with several of them no trial is pruned.
        enqueue: known-good settings that are tried right after the variant's.
        warm_start: whether the best settings of the nearest finished size are tried after those.
        max_trial_s: longest training; a trial that reaches it counts as pruned. Decides nothing else. [s]
        note: shown where the numbers are shown.
        recipe: what rebuilds its trainings elsewhere (see `studies.recipe`); decides nothing.
    """

    label: str
    n_train: int
    case_name: str
    case_digest: str
    fmu_sha256: str
    parameter_space: ParameterSpace
    output_names: tuple[str, ...]
    output_unit: str
    output_scales: tuple[float, ...]
    train_file: Path
    validation_file: Path
    test_file: Path
    train_digest: str
    validation_digest: str
    test_digest: str
    variant: str
    overrides: Mapping[str, Any] = field(default_factory=dict)
    search: SearchRanges = NETWORK_RANGES
    seed: int = 0
    n_parallel: int = 1
    pruner: str = "catch-up"
    objectives: tuple[str, ...] = ("val/mae",)
    enqueue: tuple[Mapping[str, float], ...] = ()
    warm_start: bool = False
    max_trial_s: float | None = None
    note: str = ""
    recipe: Mapping[str, Any] = field(default_factory=dict)

    @classmethod
    def from_files(
        cls,
        *,
        train_file: Path,
        validation_file: Path,
        test_file: Path,
        n_train: int,
        parameter_space: ParameterSpace,
        **declared: Any,
    ) -> "StudySpec":
        """Build a study from sets of simulations, taking digests and output names from their content.

        Raises:
            InputError: a file is missing, has fewer than `n_train` rows, or the parameters differ.
        """
        # Here, because reading Parquet files costs a third of what `studies status` takes.
        from simulation.store.row_set import RowSet

        train_set = RowSet.load(train_file)
        if train_set.n < n_train:
            raise InputError(
                f"{train_file} has {train_set.n} rows, n_train is {n_train}; simulate more or ask for less"
            )
        train = train_set.read(n_train)
        validation, test = RowSet.load(validation_file).read(), RowSet.load(test_file).read()
        for file, rows in ((train_file, train), (validation_file, validation), (test_file, test)):
            if tuple(rows.parameter_names) != parameter_space.names:
                raise InputError(f"{file} has other parameters than the case; simulate it again")
        return cls(
            n_train=n_train,
            parameter_space=parameter_space,
            output_names=tuple(train.output_names),
            train_file=train_file,
            validation_file=validation_file,
            test_file=test_file,
            train_digest=train.digest,
            validation_digest=validation.digest,
            test_digest=test.digest,
            **declared,
        )

    @property
    def shared_settings(self) -> dict[str, Any]:
        """Settings of the surrogate that every trial shares, without those left to the variant."""
        return {name: value for name, value in self.overrides.items() if value is not None}

    @cached_property
    def base_config(self) -> SurrogateConfig:
        """The variant's settings with those that all trials share.

        Raises:
            InputError: no such variant or setting.
        """
        if self.variant not in VARIANTS:
            raise InputError(f"there is no variant {self.variant!r}; choose among {sorted(VARIANTS)}")
        try:
            return VARIANTS[self.variant].replace(**self.shared_settings)
        except ValueError as error:
            raise InputError(f"training settings of {self.label}: {error}") from None

    @property
    def digests(self) -> dict[str, str]:
        """Sha256 of what the study is about, by name."""
        return {
            "case": self.case_digest,
            "fmu": self.fmu_sha256,
            "train": self.train_digest,
            "validation": self.validation_digest,
            "test": self.test_digest,
        }

    @cached_property
    def digest(self) -> str:
        """Sha256 over all that decides the trials and their errors.

        The number of trials, the device, names of files, notes and the recipe do not.
        """
        settings = {k: v for k, v in self.base_config.to_dict().items() if k not in ("device", "n_threads")}
        decisive = {
            "case": self.case_digest,
            "is_log": self.parameter_space.is_log.tolist(),
            "n_train": self.n_train,
            "train": self.train_digest,
            "validation": self.validation_digest,
            "test": self.test_digest,
            "settings": settings,
            "search": asdict(self.search),
            "output_scales": self.output_scales,
            "seed": self.seed,
            "pruner": self.pruner,
        }
        plain = {"n_parallel": 1, "objectives": ("val/mae",), "enqueue": (), "warm_start": False}
        decisive |= {
            name: getattr(self, name) for name, usual in plain.items() if getattr(self, name) != usual
        }
        return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()

    @property
    def name(self) -> str:
        """Name of the Optuna study, for example `office-quick/n0064/1a2b3c4d`."""
        return f"{self.label}/{size_name(self.n_train)}/{self.digest[:8]}"

    def folder(self, mlruns: Path) -> Path:
        """Folder of the study's finished trials."""
        return mlruns / "trials" / self.label / f"{size_name(self.n_train)}-{self.digest[:8]}"


def output_metric(output_name: str) -> str:
    """Return the name of the error of one of several outputs, of characters that MLflow allows."""
    return "mae_" + re.sub(r"[^\w.-]", "_", output_name, flags=re.ASCII)


@dataclass(frozen=True)
class TuneEvent:
    """Something a progress bar may want to know; sent at most a few times a second per study.

    Args:
        kind: what happened.
        study: name of the study.
        n_train: its training-set size.
        n_trials: trials the study shall have in total.
        n_finished: trials it has.
        index: the trial in question, from 0; -1 where the event is about the study.
        epoch: epochs of that trial so far.
        max_epochs: most epochs it may take.
        state: how a finished trial ended.
        value: validation error of the trial so far. [output's unit]
        best: least validation error among the study's completed trials, if any. [output's unit]
        message: reason of a failed or pruned trial; what is waited for, empty once it is there again.
    """

    kind: EventKind
    study: str
    n_train: int
    n_trials: int
    n_finished: int
    index: int = -1
    epoch: int = 0
    max_epochs: int = 0
    state: TrialState | None = None
    value: float | None = None
    best: float | None = None
    message: str = ""


@dataclass(frozen=True)
class StudySummary:
    """What a study has come to.

    Args:
        study: name of the study.
        label: label of the study.
        n_train: training-set size.
        n_complete: trials trained to their end.
        n_pruned: trials stopped early.
        n_failed: trials that failed for a reason of their own.
        best_index: best completed trial, None without one.
        best_metrics: its errors by name (`val/mae`, `val/p90`, `test/mae`, `test/p90`) [first output's unit];
            with several outputs also each one's own (see `output_metric`). [output's unit]
        best_config: its settings.
        wall_s: training time of all trials together. [s]
        champion: folder of the best surrogate, None without one.
    """

    study: str
    label: str
    n_train: int
    n_complete: int
    n_pruned: int
    n_failed: int
    best_index: int | None
    best_metrics: dict[str, float]
    best_config: dict[str, Any]
    wall_s: float
    champion: Path | None = None

    @property
    def n_trials(self) -> int:
        """Number of finished trials."""
        return self.n_complete + self.n_pruned + self.n_failed

    def to_dict(self) -> dict[str, Any]:
        """Return the summary as values that JSON knows."""
        return {**asdict(self), "n_trials": self.n_trials, "champion": self.champion and str(self.champion)}
