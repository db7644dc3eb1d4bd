"""What a study tells a tracking product: the protocol, a silent tracker, and the way to MLflow's."""

import errno
import logging
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

from numpy.typing import NDArray

from simulation.errors import InputError, MachineError
from studies.paths import ProjectPaths
from studies.storage_url import hide_passwords
from studies.tuning.study_spec import StudySpec, StudySummary
from studies.tuning.trial_record import TrialRecord

PATIENCE_S = 90.0

_PASSING_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.ECONNREFUSED, errno.ECONNRESET, errno.ETIMEDOUT)
_T = TypeVar("_T")
logger = logging.getLogger(__name__)

RunStatus = Literal["FINISHED", "FAILED", "KILLED"]
_REFUSED = re.compile(r"[^/\w.\- :]")
History = Mapping[str, NDArray[Any]]


def metric_name(name: str) -> str:
    """Return a metric's name without the signs that MLflow refuses: `wall[1].R` becomes `wall_1_.R`."""
    return _REFUSED.sub("_", name)


@dataclass(frozen=True)
class StageRun:
    """A finished stage other than tuning, as it shall be seen in the tracking product.

    Args:
        label: label of the study; MLflow's experiment.
        kind: what it is, for example "calibration" or "sensitivity".
        name: name a user reads, for example "n0064 calibration".
        key: digest of the stage's inputs; a stage already logged under it with the same metrics is not
            logged again.
        params: settings.
        metrics: results, one number each; their names become `metric_name`s.
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

    def __post_init__(self) -> None:
        named = {metric_name(name): value for name, value in self.metrics.items()}
        object.__setattr__(self, "metrics", named)


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

    def end_ghosts(self) -> list[str]:
        """End what says that it runs though nobody works on it; return the names."""


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

    def end_ghosts(self) -> list[str]:
        """Know of none."""
        return []


class PatientTracker:
    """Tells another tracker, waits for a store that is away, and takes its failures as a warning.

    A store that is locked, full, restarted or read-only must not cost a training: the trials that this
    tracker misses now it hears of with the next call of the same command or with the next command, stages
    when the doctor repairs.

    Args:
        tracker: the tracker that may fail.
        patience_s: how long to wait for a store that goes away, once per outage. [s]
    """

    def __init__(self, tracker: Tracker, *, patience_s: float = PATIENCE_S) -> None:
        self._tracker = tracker
        self._patience_s = patience_s
        self._is_away = False

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

    def end_ghosts(self) -> list[str]:
        """Pass it on."""
        return self._try(self._tracker.end_ghosts, [])

    def _try(self, call: Callable[[], _T], otherwise: _T) -> _T:
        deadline = time.monotonic() + (0.0 if self._is_away else self._patience_s)
        wait_s = 0.1
        while True:
            try:
                answer = call()
            except Exception as error:
                line = hide_passwords(str(error).splitlines()[0] if str(error) else "")
                passing = _passes(error)
                if passing and time.monotonic() < deadline:
                    if wait_s < 0.2:
                        cure = cure_of(line)
                        remedy = f"; {cure}" if cure else ""
                        logger.warning("MLflow's store is away (%s); waiting for it%s", line, remedy)
                    time.sleep(wait_s)
                    wait_s = min(2.0 * wait_s, 5.0)
                    continue
                self._is_away = passing
                name = type(error).__name__
                logger.warning(
                    "MLflow missed something (%s: %s); studies doctor --repair makes it good", name, line
                )
                return otherwise
            self._is_away = False
            return answer


def _passes(error: BaseException | None) -> bool:
    """Return whether an error looks like one that goes away by itself: a lost server, a lock, a full disk."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in _PASSING_ERRORS:
            return True
        if type(error).__name__ in ("OperationalError", "InterfaceError"):
            return not any(sign in str(error) for sign in ("no such", "readonly", "does not exist"))
        error = error.__cause__ or error.__context__
    return False


_REWRITE = "move it away, tuning writes it again"
_SQLITE_CURES = {
    "locked": "wait for the program that holds it, or stop it",
    "disk is full": "free some space",
    "readonly": "allow writing there",
    "unable to open": "allow reading and writing there",
}


def cure_of(line: str) -> str | None:
    """Return what helps where a database of SQLite said this line, None where nothing is known to."""
    return next((cure for sign, cure in _SQLITE_CURES.items() if sign in line), None)


def open_tracker(paths: ProjectPaths) -> Tracker:
    """Open the project's MLflow store, creating it where absent; costs MLflow's import, some 3 s.

    Runs that a killed process left RUNNING are ended on the way.

    Raises:
        InputError: the store cannot be opened.
        MachineError: it is locked, or its disk cannot be used.
    """
    from studies.keeping.versions import require_mlflow_version
    from studies.tracking.mlflow_tracker import MlflowTracker

    require_mlflow_version(paths)
    try:
        tracker = PatientTracker(MlflowTracker(paths))
    except (OSError, InputError):
        raise
    except Exception as error:
        line = hide_passwords(str(error).splitlines()[0] if str(error) else type(error).__name__)
        if paths.storage is not None:
            where = hide_passwords(paths.storage)
            kind = MachineError if _passes(error) else InputError
            raise kind(f"MLflow cannot open {where} ({line}); check the URL and the server") from error
        cure, said = cure_of(line), f"MLflow cannot open {paths.tracking_database} ({line})"
        raise (MachineError(f"{said}; {cure}") if cure else InputError(f"{said}; {_REWRITE}")) from error
    tracker.end_ghosts()
    return tracker
