"""What a study tells a tracking product: the protocol, a silent tracker, and the way to MLflow's."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

from numpy.typing import NDArray

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.tuning.study_spec import StudySpec, StudySummary
from studies.tuning.trial_record import TrialRecord

_T = TypeVar("_T")
logger = logging.getLogger(__name__)

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
        recipe: what rebuilds it (see `studies.recipe`); empty where nothing does.
        environment: versions, machine and state of the code that made it.
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
    recipe: Mapping[str, Any] = field(default_factory=dict)
    environment: Mapping[str, str] = field(default_factory=dict)


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


class PatientTracker:
    """Tells another tracker, and takes its failures as a warning: what it misses now it hears next time.

    A store that is locked, full or read-only must not cost a training.

    Args:
        tracker: the tracker that may fail.
    """

    def __init__(self, tracker: Tracker) -> None:
        self._tracker = tracker

    def start_study(self, spec: StudySpec, *, n_trials: int) -> None:
        """Pass it on."""
        self._try(lambda: self._tracker.start_study(spec, n_trials=n_trials), None)

    def log_trial(self, spec: StudySpec, record: TrialRecord, history: Callable[[], History]) -> None:
        """Pass it on."""
        self._try(lambda: self._tracker.log_trial(spec, record, history), None)

    def trial_run_id(self, spec: StudySpec, key: str) -> str:
        """Ask, empty without an answer."""
        return self._try(lambda: self._tracker.trial_run_id(spec, key), "")

    def finish_study(self, spec: StudySpec, summary: StudySummary, status: RunStatus) -> None:
        """Pass it on."""
        self._try(lambda: self._tracker.finish_study(spec, summary, status), None)

    def register_champion(self, spec: StudySpec, folder: Path) -> None:
        """Pass it on."""
        self._try(lambda: self._tracker.register_champion(spec, folder), None)

    def fetch_champion(self, label: str, n_train: int, folder: Path) -> bool:
        """Ask, False without an answer."""
        return self._try(lambda: self._tracker.fetch_champion(label, n_train, folder), False)

    def log_stage(self, stage: StageRun) -> None:
        """Pass it on."""
        self._try(lambda: self._tracker.log_stage(stage), None)

    def _try(self, call: Callable[[], _T], otherwise: _T) -> _T:
        try:
            return call()
        except Exception as error:
            line = str(error).splitlines()[0] if str(error) else ""
            logger.warning(
                "MLflow missed something (%s: %s); the next run makes it good", type(error).__name__, line
            )
            return otherwise


_REWRITE = "move it away, tuning writes it again"
_SQLITE_CURES = {
    "locked": "wait for the program that holds it, or stop it",
    "disk is full": "free some space",
    "readonly": "allow writing there",
    "unable to open": "allow reading and writing there",
}


def open_tracker(paths: ProjectPaths) -> Tracker:
    """Open MLflow's store under `mlruns/`, creating it where absent; costs MLflow's import, some 3 s.

    Raises:
        InputError: the database cannot be opened.
    """
    from studies.tracking.mlflow_tracker import MlflowTracker

    try:
        return PatientTracker(MlflowTracker(paths.tracking_database, paths.artifacts, root=paths.root))
    except OSError:
        raise
    except Exception as error:
        line = str(error).splitlines()[0] if str(error) else type(error).__name__
        remedy = next((cure for sign, cure in _SQLITE_CURES.items() if sign in line), _REWRITE)
        raise InputError(f"MLflow cannot open {paths.tracking_database} ({line}); {remedy}") from error
