"""PostgreSQL: connections that come back after a restart, our schema, and locks between machines.

The only module that speaks psycopg.
"""

import atexit
import hashlib
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from threading import Lock
from types import TracebackType
from typing import TYPE_CHECKING, Any, TypeVar

from simulation.errors import InputError, MachineError
from studies.storage_url import hide_passwords

if TYPE_CHECKING:
    from psycopg import Connection

_T = TypeVar("_T")
Row = tuple[Any, ...]

SCHEMA_VERSION = 1
CONNECT_TIMEOUT_S = 10
_SCHEMAS = ("optuna", "mlflow", "studies")
_TABLES = """
create table if not exists studies.schema_version (version integer not null);
create table if not exists studies.studies (
    name text primary key,
    label text not null,
    n_train integer not null,
    entry json not null,
    created timestamptz not null default now()
);
create table if not exists studies.trials (
    study text not null,
    index integer not null,
    record json not null,
    history bytea not null,
    surrogate bytea,
    written timestamptz not null default now(),
    primary key (study, index)
);
create table if not exists studies.claims (
    study text not null,
    index integer not null,
    claim json not null,
    token text not null,
    epoch integer not null default 0,
    value double precision,
    heard timestamptz not null default now(),
    primary key (study, index)
);
"""
# A lock must not outlive a machine that vanished without a word.
_SESSION = """
select set_config('application_name', 'studies', false),
       set_config('tcp_keepalives_idle', '30', false),
       set_config('tcp_keepalives_interval', '10', false),
       set_config('tcp_keepalives_count', '3', false)
"""
_REFUSALS = {
    "password authentication failed": "correct the user or the password (or set it in ~/.pgpass)",
    "no password supplied": "give the password in the URL, in $PGPASSWORD or in ~/.pgpass",
    "authentication failed": "correct the user of the URL",
    "no pg_hba.conf entry": "let the server's pg_hba.conf admit this user and machine",
    "does not exist": "create it, or correct the URL",
    "permission denied": "let the server's administrator grant it",
    "could not translate host name": "correct the host of the URL",
    "failed to resolve host": "correct the host of the URL",
    "invalid": "correct the URL",
}
_UNRESOLVED = ("could not translate host name", "failed to resolve host")


class StorageAwayError(MachineError):
    """The server cannot be reached at the moment; it may come back."""


class Database:
    """One PostgreSQL database, for the threads of one process.

    Args:
        storage: its URL.
    """

    def __init__(self, storage: str) -> None:
        self._storage = storage
        self.shown = hide_passwords(storage)
        self._guard = Lock()
        self._connection: Connection | None = None
        self._spare: deque[Connection] = deque()
        self._is_ready = False
        atexit.register(self.close)

    def close(self) -> None:
        """Hang up; the next question connects again."""
        for connection in (*self._spare, *([self._connection] if self._connection else [])):
            connection.close()
        self._spare.clear()

    def rows(self, statement: str, values: Sequence[Any] = ()) -> list[Row]:
        """Run a statement that may be run twice with the effect of once, and return its rows.

        Raises:
            InputError: the server refuses it.
            StorageAwayError: the server cannot be reached.
        """
        return self.run(lambda connection: _fetch(connection, statement, values))

    def run(self, work: Callable[["Connection"], _T]) -> _T:
        """Do something with the connection, twice where it was lost in between.

        Raises:
            InputError: the server refuses it.
            StorageAwayError: the server cannot be reached.
        """
        self._require_driver()
        from psycopg import Error, OperationalError

        with self._guard:
            for is_last in (False, True):
                connection = self._connection
                if connection is None or connection.closed:
                    connection = self._connection = self.connect()
                try:
                    return work(connection)
                except OperationalError as error:
                    connection.close()
                    if is_last:
                        raise self._explained(error) from None
                except Error as error:
                    raise self._explained(error) from None
        raise AssertionError("unreachable")

    def _require_driver(self) -> None:
        try:
            import psycopg  # noqa: F401
        except ImportError:
            raise InputError(
                f"the storage {self.shown} needs the driver psycopg; type: pip install '.[postgres]'"
            ) from None

    def connect(self) -> "Connection":
        """Open a connection; the first one makes our schemas where they are absent.

        Raises:
            InputError: there is no driver, the server refuses us, or our schema is of another version.
            StorageAwayError: the server cannot be reached.
        """
        self._require_driver()
        from psycopg import Error, OperationalError, connect

        try:
            connection = connect(
                self._storage,
                autocommit=True,
                connect_timeout=CONNECT_TIMEOUT_S,
                keepalives_idle=30,
                keepalives_interval=10,
                keepalives_count=3,
            )
            try:
                connection.execute(_SESSION)
                if not self._is_ready:
                    self._prepare(connection)
                    self._is_ready = True
            except BaseException:
                connection.close()
                raise
        except (OperationalError, Error) as error:
            raise self._explained(error) from None
        return connection

    @contextmanager
    def locked(self, name: str) -> Iterator[None]:
        """Hold a lock of the server; a lost connection gives it back."""
        key = int.from_bytes(hashlib.sha256(f"studies {name}".encode()).digest()[:8], signed=True)
        connection = self._lock_connection()
        try:
            connection.execute("select pg_advisory_lock(%s)", (key,))
        except Exception as error:
            connection.close()
            raise self._explained(error) from None
        except BaseException:
            connection.close()
            raise
        try:
            yield
        finally:
            try:
                connection.execute("select pg_advisory_unlock(%s)", (key,))
                self._spare.append(connection)
            except Exception:  # the lock went with the connection
                connection.close()

    def _lock_connection(self) -> "Connection":
        while self._spare:
            connection = self._spare.pop()
            try:
                connection.execute("select 1")
                return connection
            except Exception:  # the server was restarted since
                connection.close()
        return self.connect()

    def _prepare(self, connection: "Connection") -> None:
        if _fetch(connection, "select to_regclass('studies.schema_version')")[0][0] is None:
            with connection.transaction():
                connection.execute("select pg_advisory_xact_lock(7365747570)")
                for schema in _SCHEMAS:
                    connection.execute(f"create schema if not exists {schema}".encode())
                connection.execute(_TABLES)
                connection.execute(
                    "insert into studies.schema_version select %s "
                    "where not exists (select from studies.schema_version)",
                    (SCHEMA_VERSION,),
                )
        ((version,),) = _fetch(connection, "select version from studies.schema_version")
        if version != SCHEMA_VERSION:
            raise InputError(
                f"the storage {self.shown} has version {version} of our schema, this program knows "
                f"{SCHEMA_VERSION}; use the program that wrote it, or another database"
            )

    def _explained(self, error: Exception) -> InputError:
        from psycopg import OperationalError

        lines = [line.strip() for line in hide_passwords(str(error)).splitlines() if line.strip()]
        said = lines[0].removeprefix("connection failed: ") if lines else type(error).__name__
        # Where the host was known before, or names cannot be looked up now, it is the network that is away.
        is_away = any(sign in said for sign in _UNRESOLVED) and (self._is_ready or "Temporary" in said)
        for sign, remedy in _REFUSALS.items():
            if not is_away and sign in said and "No such file" not in said:
                return InputError(f"the storage {self.shown} refuses ({said}); {remedy}")
        if isinstance(error, OperationalError):
            return StorageAwayError(
                f"the storage {self.shown} does not answer ({said}); start the server or correct the URL"
            )
        return InputError(f"the storage {self.shown} fails ({type(error).__name__}: {said})")


class PostgresLock:
    """A named lock that one process on any machine holds at a time.

    Args:
        storage: URL of the database.
        name: what is locked.
    """

    def __init__(self, storage: str, name: str) -> None:
        self._lock = database(storage).locked(name)

    def __enter__(self) -> "PostgresLock":
        self._lock.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.__exit__(kind, error, trace)


def database(storage: str) -> Database:
    """Return this process's way to a database."""
    return _database(storage, os.getpid())  # a forked process must not speak on its parent's connection


@cache
def _database(storage: str, pid: int) -> Database:
    return Database(storage)


def _fetch(connection: "Connection", statement: str, values: Sequence[Any] = ()) -> list[Row]:
    cursor = connection.execute(statement.encode(), values)
    return cursor.fetchall() if cursor.description else []
