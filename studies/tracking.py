"""What a study tells a tracking product: the protocol, a silent tracker, and the way to MLflow's."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

from numpy.typing import NDArray

from studies.paths import ProjectPaths
from studies.study_spec import StudySpec, StudySummary
from studies.trial_record import TrialRecord

RunStatus = Literal["FINISHED", "FAILED", "KILLED"]
History = Mapping[str, NDArray[Any]]


@dataclass(frozen=True)
class StageRun:
    """A finished stage other than tuning, as it shall be seen in the tracking product.

    Args:
        label: label of the study; MLflow's experiment.
        kind: what it is, for example "calibration" or "sensitivity".
        name: name a user reads, for example "n0064 calibration".
        key: digest of the stage's inputs; a stage already logged under it is not logged again.
        params: settings.
        metrics: results, one number each.
        curves: results over steps: pairs of step and value, for example the best MSE over model calls.
        tags: what to search for (case, n_train, digests, ...).
        figures: image files.
        artifacts: other files.
        started_s: start of the stage. [s since 1970, UTC]
        wall_s: its duration. [s]
        status: how it ended.
        note: Markdown, shown on the run's page.
    """

    label: str
    kind: str
    name: str
    key: str
    params: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)
    curves: Mapping[str, Sequence[tuple[int, float]]] = field(default_factory=dict)
    tags: Mapping[str, Any] = field(default_factory=dict)
    figures: Sequence[Path] = ()
    artifacts: Sequence[Path] = ()
    started_s: float | None = None
    wall_s: float = 0.0
    status: RunStatus = "FINISHED"
    note: str = ""


class Tracker(Protocol):
    """Somebody who is told. Telling twice has the effect of telling once; nothing told is ever asked back."""

    def start_study(self, spec: StudySpec, *, n_trials: int) -> None:
        """Hear that a study begins or goes on."""

    def log_trial(self, spec: StudySpec, record: TrialRecord, history: Callable[[], History]) -> None:
        """Hear of a finished trial; `history` gives its learning curves where they are needed."""

    def trial_run_id(self, spec: StudySpec, key: str) -> str:
        """Return the tracker's own name for a trial, empty without one."""

    def finish_study(self, spec: StudySpec, summary: StudySummary, status: RunStatus) -> None:
        """Hear how a study ended."""

    def register_champion(self, spec: StudySpec, folder: Path) -> None:
        """Hear of a study's best surrogate."""

    def fetch_champion(self, label: str, n_train: int, folder: Path) -> bool:
        """Copy the files of the registered champion into an empty folder; return whether there is one."""

    def log_stage(self, stage: StageRun) -> None:
        """Hear of another finished stage."""


class NullTracker:
    """A tracker that keeps nothing."""

    def start_study(self, spec: StudySpec, *, n_trials: int) -> None:
        """Do nothing."""

    def log_trial(self, spec: StudySpec, record: TrialRecord, history: Callable[[], History]) -> None:
        """Do nothing."""

    def trial_run_id(self, spec: StudySpec, key: str) -> str:
        """Know of no run."""
        return ""

    def finish_study(self, spec: StudySpec, summary: StudySummary, status: RunStatus) -> None:
        """Do nothing."""

    def register_champion(self, spec: StudySpec, folder: Path) -> None:
        """Do nothing."""

    def fetch_champion(self, label: str, n_train: int, folder: Path) -> bool:
        """Know of no champion."""
        return False

    def log_stage(self, stage: StageRun) -> None:
        """Do nothing."""


def open_tracker(paths: ProjectPaths) -> Tracker:
    """Open MLflow's store under `mlruns/`, creating it where absent (some 7 s); costs MLflow's import."""
    from studies.mlflow_tracker import MlflowTracker

    return MlflowTracker(paths.tracking_database, paths.artifacts, root=paths.root)
