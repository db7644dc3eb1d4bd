"""A PostgreSQL database that several projects and users share."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from simulation.errors import InputError
from studies.patience import waited_for

if TYPE_CHECKING:
    import psycopg

# Any number that is always the same.
_LOCK = 7365747570


@contextmanager
def alone_on(storage: str) -> Iterator[None]:
    """Let one process of all projects at a time make tables, in schemas of Optuna and MLflow each.

    Both own a table `alembic_version`. Who makes tables that another one makes at the same moment is refused.

    Args:
        storage: URL of the database. A server that is away is waited for.

    Raises:
        InputError: it refuses, or what speaks to it is not installed.
        MachineError: it stays away.
    """
    try:
        import psycopg
    except ImportError:
        raise InputError("PostgreSQL needs: pip install 'pelsvae-studies[postgres]'") from None

    def locked() -> "psycopg.Connection":
        connection = psycopg.connect(storage, autocommit=True, connect_timeout=10)
        # The lock ends with the connection.
        connection.execute(f"select pg_advisory_lock({_LOCK})".encode())
        for schema in ("optuna", "mlflow"):
            connection.execute(f"create schema if not exists {schema}".encode())
        return connection

    try:
        connection = waited_for(locked)
    except psycopg.Error as error:
        said = next(iter(str(error).splitlines()), type(error).__name__)
        raise InputError(f"the storage {storage} cannot be used ({said}); correct it or start it") from None
    with connection:
        yield
