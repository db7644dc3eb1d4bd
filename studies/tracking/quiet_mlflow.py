"""MLflow without telemetry, log chatter and the deprecation warnings of its own dependencies."""

import logging
import os
import sqlite3
import warnings
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from simulation.errors import InputError, MachineError
from simulation.foreign_text import shortened
from simulation.pool.safe_start import environment_restored
from studies.patience import Patient, waited_for
from studies.words.quiet_loggers import hush

with environment_restored(), warnings.catch_warnings():
    os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")  # read while MLflow is imported
    warnings.simplefilter("ignore")
    import mlflow
    from mlflow import MlflowException, entities
    from mlflow.store.artifact.artifact_repository_registry import get_artifact_repository
    from mlflow.store.artifact.local_artifact_repo import LocalArtifactRepository

for _name in ("alembic.runtime.migration", "alembic.runtime.plugins", "mlflow"):
    hush(_name, logging.WARNING)
# It prints tracebacks of errors that it raises as well; who catches them says one line.
hush("mlflow.store.db.utils", logging.CRITICAL)
# MLflow writes rows that a server may already have, and goes on where it refuses them.
hush("psycopg", logging.ERROR)

__all__ = [
    "LocalArtifactRepository",
    "MlflowException",
    "connect",
    "entities",
    "get_artifact_repository",
    "make_database",
    "mlflow",
    "storing_files",
]


class _PatientClient(Patient, mlflow.MlflowClient):
    pass


def connect(uri: str) -> mlflow.MlflowClient:
    """Open the store at a URI for runs and models alike; an SQLite file gets its schema here (some 7 s).

    MLflow's own functions and settings are the script's that calls: what is done here goes through a client.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        client = waited_for(_PatientClient, tracking_uri=uri, registry_uri=uri)
        client.search_registered_models(max_results=1)  # opens the registry's half too
        return client


def make_database(file: Path) -> None:
    """Make an SQLite store that is there whole or not at all, where none is.

    MLflow gives it a schema in dozens of steps, each kept at once: killed between two of them, it would leave
    a database that no version of it opens.

    Args:
        file: Of the store, in a folder that exists; the caller's lock keeps others out.
    """
    making, made = file.with_name(f".{file.name}-making"), file.with_name(f".{file.name}-made")
    for old in file.parent.glob(f".{file.name}-ma*"):
        old.unlink()
    connect(f"sqlite:///{making.resolve().as_posix()}")
    # MLflow keeps its connections, so the file is copied and not renamed.
    with closing(sqlite3.connect(making)) as source, closing(sqlite3.connect(made)) as target:
        source.backup(target)
    made.replace(file)
    making.unlink()


@contextmanager
def storing_files(run_id: str) -> Iterator[None]:
    """Say in a line that the store of a run's artifacts refuses, which may be a server.

    Raises:
        MachineError: it does.
    """
    try:
        yield
    except InputError:
        raise
    # What is sent over a network fails with errors of many kinds and without a number of the system.
    except (mlflow.MlflowException, OSError) as error:
        if getattr(error, "errno", None) is not None:
            raise
        line = next(iter(str(error).splitlines()), type(error).__name__)
        raise MachineError(
            f"the files of MLflow's run {run_id} cannot be stored ({shortened(line)}); see to its store of "
            "artifacts, then type the command again"
        ) from None
