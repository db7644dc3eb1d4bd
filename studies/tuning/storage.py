"""Optuna's storage: opened, and locked for whoever begins a trial."""

import hashlib
import logging
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress

from optuna.storages import RDBStorage

from simulation.file_lock import FileLock
from studies.paths import ProjectPaths, opening
from studies.patience import Patient, waited_for
from studies.tuning.attempts import experimental, run_again
from studies.words.quiet_loggers import hush

# Two heartbeats may be missed before a worker on another machine counts as dead.
HEARTBEAT_S, GRACE_S = 10, 30

hush("optuna", logging.ERROR)


class _PatientStorage(Patient, RDBStorage):
    pass


def open_storage(paths: ProjectPaths) -> RDBStorage:
    """Open the project's Optuna storage, making it where there is none.

    Raises:
        InputError: the storage refuses or is no database of Optuna.
        MachineError: it does not answer.
    """
    with opening(paths, "Optuna", paths.optuna_database):
        # Before Optuna opens it: the write-ahead log is a property of the file and stays with it.
        if paths.storage is None and not paths.optuna_database.is_file():
            with closing(sqlite3.connect(paths.optuna_database)) as made:
                made.execute("pragma journal_mode=wal")
        # SQLite has one writer at a time, for whom others wait; a server may close idle connections.
        waits, asks = {"connect_args": {"timeout": 60}}, {"pool_pre_ping": True}
        with experimental():
            storage = _PatientStorage(
                paths.optuna_url,
                engine_kwargs=waits if paths.storage is None else asks,
                heartbeat_interval=HEARTBEAT_S,
                grace_period=GRACE_S,
                heartbeat_stale_trial_callback=run_again,
            )
    if paths.storage is None:
        from sqlalchemy import event

        def on_connect(database: sqlite3.Connection, _: object) -> None:
            # A power cut may lose the last trial, never the file: an eighth of the time of a full sync.
            database.execute("pragma synchronous=normal")

        event.listen(storage.engine, "connect", on_connect)
    return storage


@contextmanager
def storage_of(paths: ProjectPaths) -> Iterator[RDBStorage]:
    """Open the project's Optuna storage, and close its connections at the end.

    Yields:
        the storage.
    """
    storage = open_storage(paths)
    try:
        yield storage
    finally:
        storage.remove_session()
        storage.engine.dispose()


@contextmanager
def study_locked(
    storage: RDBStorage, paths: ProjectPaths, name: str, *, file: str = ".optuna.lock"
) -> Iterator[Callable[[], None]]:
    """Let one worker of a study at a time begin a trial, so that no study gets a trial too many.

    Args:
        storage: the project's.
        paths: the project.
        name: the study, or what else one process at a time may do.
        file: the lock where the storage is a file; whoever opens that holds the usual one.

    Yields:
        a function that gives the lock back early.
    """
    if paths.storage is None:
        with FileLock(paths.mlruns / file) as lock:
            yield lock.release
        return
    from sqlalchemy import Connection, text
    from sqlalchemy.exc import DBAPIError

    # PostgreSQL's locks are named by signed 64-bit numbers.
    number = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], signed=True)

    def locked() -> Connection:
        connection = storage.engine.connect()
        connection.execute(text("select pg_advisory_lock(:n)"), {"n": number})
        return connection

    connection = waited_for(locked)

    def release() -> None:
        with suppress(DBAPIError):  # of a server that was restarted, which forgot its locks
            if not connection.closed:
                connection.execute(text("select pg_advisory_unlock_all()"))
        connection.close()  # gives the lock back, too

    try:
        yield release
    finally:
        release()
