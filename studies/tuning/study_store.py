"""Optuna's side of a study: a view of its finished trials, in the journal or in the database.

Optuna is told of a trial when its record is written, in one step. So its store holds no running trial that
could outlive its owner, and it can be written again from the records at any time.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

import optuna
from optuna.storages import BaseStorage, JournalStorage, RDBStorage
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
from optuna.trial import FrozenTrial
from optuna.trial import TrialState as OptunaState
from sqlalchemy.exc import DBAPIError

from simulation.errors import InputError
from simulation.file_lock import FileLock
from studies.paths import ProjectPaths
from studies.storage_url import hide_passwords, in_schema
from studies.tuning.coordinates import distributions
from studies.tuning.postgres import CONNECT_TIMEOUT_S, StorageAwayError, database
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord
from studies.tuning.trial_store import TrialStore, named_lock

JOURNAL = "optuna.journal"
N_SHOWN_REPORTS = 8  # per trial in Optuna's store; the record has all

_STATES = {"complete": OptunaState.COMPLETE, "pruned": OptunaState.PRUNED, "failed": OptunaState.FAIL}


class StudyStore:
    """One study in Optuna's store.

    Args:
        spec: the study.
        paths: the project.

    Raises:
        InputError: Optuna's store cannot be opened.
    """

    def __init__(self, spec: StudySpec, paths: ProjectPaths) -> None:
        self._spec = spec
        self._paths = paths
        self._storage = open_optuna(paths)
        with named_lock(paths, f"optuna/{spec.name}"), _plain_errors(paths):
            self._study = self._open()

    def tell(self, store: TrialStore) -> None:
        """Tell Optuna of the finished trials that it does not know; what the records say is true.

        Args:
            store: the study's records.
        """
        with named_lock(self._paths, f"optuna/{self._spec.name}"), _plain_errors(self._paths):
            known = [
                (trial.user_attrs.get("index"), trial.user_attrs.get("started_s"))
                for trial in self._study.get_trials(deepcopy=False)
            ]
            records = {(record.index, record.started_s): record for record in store.records()}
            if len(set(known)) < len(known) or not set(known) <= set(records):
                optuna.delete_study(study_name=self._spec.name, storage=self._storage)
                self._study, known = self._open(), []
            for key, record in records.items():
                if key not in set(known):
                    self._study.add_trial(self._trial(record))

    def close(self) -> None:
        """Hang up where there is a server; the next question connects again."""
        if isinstance(self._storage, RDBStorage):
            self._storage.engine.dispose()

    def _open(self) -> optuna.Study:
        return optuna.create_study(
            storage=self._storage,
            study_name=self._spec.name,
            directions=["minimize"] * len(self._spec.objectives),
            load_if_exists=True,
        )

    def _trial(self, record: TrialRecord) -> FrozenTrial:
        values: list[float] | None = None
        if record.state == "complete":
            values = [record.metrics[name] for name in self._spec.objectives]
        elif record.state == "pruned" and len(self._spec.objectives) == 1 and record.value is not None:
            values = [record.value]
        # In a database every attribute and every reported value costs milliseconds.
        result = {
            "reason": record.reason,
            "n_epochs": record.n_epochs,
            "wall_s": record.wall_s,
            "seed": record.seed,
            "origin": record.origin,
            "attempts": record.attempts,
            "owner": record.owner,
        }
        return FrozenTrial(
            number=-1,  # Optuna numbers it
            trial_id=-1,
            state=_STATES[record.state],
            value=None,
            values=values,
            datetime_start=datetime.fromtimestamp(record.started_s),
            datetime_complete=datetime.fromtimestamp(record.ended_s),
            params=dict(record.params),
            distributions=distributions(self._spec.search),
            user_attrs={
                "index": record.index,
                "started_s": record.started_s,
                "config": record.config,
                "result": {**result, **record.metrics},
            },
            system_attrs={},
            intermediate_values=_thinned(record.reports),
        )


def _thinned(reports: Mapping[str, float]) -> dict[int, float]:
    """Return some of the reported values, evenly, the last among them."""
    found = sorted((int(step), value) for step, value in reports.items())
    return dict(found[:: -max(1, -(-len(found) // N_SHOWN_REPORTS))])


def open_optuna(paths: ProjectPaths) -> BaseStorage:
    """Open the project's store of all Optuna studies, and make it where it is absent.

    Raises:
        InputError: it is damaged, of another version, or refuses us.
    """
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    if paths.storage is not None:
        database(paths.storage).rows("select 1")  # says in one line what is wrong, and makes the schemas
        with named_lock(paths, "optuna"), _plain_errors(paths):
            return RDBStorage(
                in_schema(paths.storage, "optuna"),
                engine_kwargs={
                    "pool_pre_ping": True,
                    "pool_size": 2,
                    "connect_args": {"connect_timeout": CONNECT_TIMEOUT_S},
                },
            )
    journal = paths.mlruns / JOURNAL
    journal.parent.mkdir(parents=True, exist_ok=True)
    try:
        return JournalStorage(JournalFileBackend(str(journal), lock_obj=_JournalLock(journal)))
    except (ValueError, KeyError, TypeError) as error:  # whatever Optuna stumbles over when it reads
        raise InputError(
            f"{journal} is damaged ({type(error).__name__}: {error}); move it away, the finished trials "
            "in mlruns/trials are written to a new one"
        ) from None


@contextmanager
def _plain_errors(paths: ProjectPaths) -> Iterator[None]:
    """Turn what Optuna raises when the server is away into our own error, which may be waited out."""
    try:
        yield
    except (optuna.exceptions.StorageInternalError, DBAPIError) as error:
        cause = error.__cause__ or error
        said = next((line for line in str(cause).splitlines() if line.strip()), type(cause).__name__)
        shown = hide_passwords(f"{paths.storage or paths.mlruns}")
        raise StorageAwayError(f"Optuna's store in {shown} fails ({hide_passwords(said)})") from None
    except RuntimeError as error:
        if "compatible" not in str(error):
            raise
        said = " ".join(str(error).split()).partition("). ")[0]
        raise InputError(
            f"Optuna's store is of another version ({hide_passwords(said)})); type: studies doctor --upgrade"
        ) from None


class _JournalLock(JournalFileOpenLock):
    """Optuna's journal lock, released with its owner, that cuts off the half line of a killed writer."""

    def __init__(self, journal: Path) -> None:
        self._journal = journal
        self._lock = FileLock(journal.with_name(f"{journal.name}.lock"))

    def acquire(self) -> bool:
        self._lock.acquire()
        with self._journal.open("r+b") as file:
            size = file.seek(0, os.SEEK_END)
            if size:
                file.seek(size - 1)
                if file.read(1) != b"\n":
                    file.seek(0)
                    file.truncate(file.read().rfind(b"\n") + 1)
        return True

    def release(self) -> None:
        self._lock.release()
