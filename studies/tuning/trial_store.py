"""The durable records of a study: what every place that keeps them promises, and the way to this project's.

Importing this loads neither Optuna nor MLflow nor torch.
"""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from numpy.typing import NDArray

from simulation.file_lock import FileLock
from studies.paths import ProjectPaths
from studies.tuning.claim import Claim
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord

LOCK_FOLDER = "locks"


@dataclass(frozen=True)
class RunningTrial:
    """A trial that somebody works on.

    Args:
        index: its place in the study.
        owner: host, process and its start.
        started_s: start of this attempt. [s since 1970, UTC]
        epoch: epochs so far.
        max_epochs: most epochs it may take.
        value: its validation error so far. [output's unit]
        heard_s: when its owner was last heard of. [s since 1970, UTC]
        attempt: 1 for the first, more for a trial that was interrupted.
    """

    index: int
    owner: Mapping[str, Any]
    started_s: float
    epoch: int
    max_epochs: int
    value: float | None
    heard_s: float
    attempt: int = 1


@dataclass(frozen=True)
class StudyEntry:
    """What is known of a study without opening its trials.

    Args:
        name: name of the study.
        label: label of case and profile.
        case_name: name of the case.
        n_train: training-set size.
        n_planned: trials it shall have, as the last command asked for.
        n_parallel: trials that may run side by side.
        seed: its seed.
        variant: named form of the surrogate.
        output_unit: unit of the errors.
        digests: sha256 of case, FMU and data sets.
        note: shown wherever the numbers are shown.
        recipe: all that rebuilds it, as JSON values.
        created_s: when it was first asked for. [s since 1970, UTC]
    """

    name: str
    label: str
    case_name: str
    n_train: int
    n_planned: int
    n_parallel: int
    seed: int
    variant: str
    output_unit: str
    digests: dict[str, str]
    note: str = ""
    recipe: dict[str, Any] = field(default_factory=dict)
    created_s: float = 0.0

    @classmethod
    def of(cls, spec: StudySpec, *, n_planned: int, created_s: float) -> "StudyEntry":
        """Return the entry of a study that shall have so many trials."""
        return cls(
            name=spec.name,
            label=spec.label,
            case_name=spec.case_name,
            n_train=spec.n_train,
            n_planned=n_planned,
            n_parallel=spec.n_parallel,
            seed=spec.seed,
            variant=spec.variant,
            output_unit=spec.output_unit,
            digests=dict(spec.digests),
            note=spec.note,
            recipe=dict(spec.recipe),
            created_s=created_s,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return the entry as JSON values."""
        return asdict(self)


class TrialStore(Protocol):
    """Keeps one study's finished trials, each exactly once, and who works on the others."""

    @property
    def name(self) -> str:
        """Name of the study."""

    @property
    def place(self) -> str:
        """Where the records lie, as a user may be told."""

    def entry(self) -> StudyEntry | None:
        """Return what is known of the study, None where nobody has asked for it."""

    def describe(self, entry: StudyEntry) -> None:
        """Keep what is known of the study; the time of its first entry stays."""

    def finished(self) -> list[int]:
        """Return the indices of the finished trials, ascending; much cheaper than `records`."""

    def records(self) -> list[TrialRecord]:
        """Read all finished trials, ordered by index; there may be gaps."""

    def record(self, index: int) -> TrialRecord | None:
        """Read a finished trial, None where there is none."""

    def write(
        self, record: TrialRecord, history: Mapping[str, NDArray[Any]], surrogate: Path | None = None
    ) -> bool:
        """Keep a finished trial, whole or not at all, and forget its claim.

        Args:
            record: what is known of the trial.
            history: learning curves, one array per name, each of shape (epochs validated,).
            surrogate: folder with the saved surrogate.

        Returns:
            False where the trial was finished before: the first record stays.
        """

    def history(self, index: int) -> dict[str, NDArray[Any]]:
        """Read a trial's learning curves, each of shape (epochs validated,).

        Raises:
            KeyError: there is no such trial.
        """

    def fetch_surrogate(self, index: int, folder: Path) -> bool:
        """Copy a trial's saved surrogate into an existing folder; return whether there is one."""

    def keep_only_best(self) -> None:
        """Remove the surrogates of all finished trials but the best."""

    def running(self) -> list[RunningTrial]:
        """Return the trials that have an owner, ordered by index; it may have died since."""

    def lock(self) -> AbstractContextManager[Any]:
        """Return the lock under which trials are claimed; it excludes other processes and machines."""

    def claims(self) -> list[tuple[Claim, float]]:
        """Return every claim and how long its owner has been silent, ordered by index. [s]."""

    def put_claim(self, claim: Claim) -> None:
        """Keep a claim in the place of the trial's former one."""

    def drop_claim(self, index: int) -> None:
        """Forget a claim."""

    def beat(self, claim: Claim, *, epoch: int, value: float | None) -> None:
        """Note that a claim's owner lives, and how far the trial is; without effect once it has lost it."""


def open_trials(paths: ProjectPaths, study: StudySpec | str) -> TrialStore:
    """Open the records of a study, by what it is or by its name.

    Raises:
        InputError: the storage cannot be reached, or the name is no study's.
    """
    name = study if isinstance(study, str) else study.name
    if paths.storage is not None:
        from studies.tuning.trial_store_postgres import PostgresTrials

        return PostgresTrials(paths.storage, name)
    from studies.tuning.trial_store_files import FileTrials

    return FileTrials(paths.mlruns, name)


def list_studies(paths: ProjectPaths) -> list[StudyEntry]:
    """Return all studies of the project, ordered by label, size and age.

    Raises:
        InputError: the storage cannot be reached.
    """
    if paths.storage is not None:
        from studies.tuning.trial_store_postgres import postgres_studies

        found: Sequence[StudyEntry] = postgres_studies(paths.storage)
    else:
        from studies.tuning.trial_store_files import file_studies

        found = file_studies(paths.mlruns)
    return sorted(found, key=lambda entry: (entry.label, entry.n_train, entry.created_s, entry.name))


def named_lock(paths: ProjectPaths, name: str) -> AbstractContextManager[Any]:
    """Return a lock that one process holds at a time, among all machines that share the storage.

    It is given back when its holder dies, however it dies. Taking it waits.

    Args:
        paths: the project.
        name: what is locked, for example `mlflow/office-quick`.
    """
    if paths.storage is not None:
        from studies.tuning.postgres import PostgresLock

        return PostgresLock(paths.storage, name)
    return FileLock(paths.mlruns / LOCK_FOLDER / f"{name.replace('/', '--')}.lock")
