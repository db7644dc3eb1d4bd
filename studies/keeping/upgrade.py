"""Bring stores of an earlier version up to date, after a copy has been kept aside."""

import os
import shutil
import sqlite3
import subprocess
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import unquote, urlsplit

from alembic import command

from simulation.errors import InputError
from studies.console import Console
from studies.keeping.entries import describe, undescribed
from studies.keeping.mlflow_tables import connected
from studies.keeping.optuna_view import upgrade_optuna
from studies.keeping.versions import Version, migrations_of, versions_of
from studies.keeping.wording import readable
from studies.paths import ProjectPaths
from studies.storage_url import hide_passwords
from studies.tuning.trial_store import named_lock

COPIES = "copies"
"""Folder of the databases as they were before an upgrade."""


def upgrade(paths: ProjectPaths, console: Console, *, is_copied: bool) -> list[str]:
    """Upgrade what is behind.

    Args:
        paths: the project.
        console: tells what is done.
        is_copied: whether the user has kept a copy of a PostgreSQL database already.

    Returns:
        What was done, a line each.

    Raises:
        InputError: no copy can be kept, or a store is ahead of this installation.
    """
    versions = versions_of(paths)
    for one in versions:
        if one.standing == "ahead":
            raise InputError(
                f"{one.where} was written by a newer version ({one.found}, this one speaks {one.spoken}); "
                f"install a newer {one.store.lower()}, nothing was changed"
            )
    done = []
    for one in versions:
        if one.standing == "behind" and one.store in ("MLflow", "Optuna"):
            done.append(_database(paths, console, one, is_copied=is_copied))
    for folder in undescribed(paths):
        done.append(describe(paths, folder))
    for line in done:
        console.say(f"upgrade: {line}")
    return done


def _database(paths: ProjectPaths, console: Console, one: Version, *, is_copied: bool) -> str:
    with named_lock(paths, "mlflow/mlflow" if one.store == "MLflow" else "optuna"):
        if is_copied and paths.storage is not None:
            copy = None
        else:
            with console.stage("upgrade", f"keeping a copy of {one.where}"):
                copy = _keep_copy(paths, one)
        with console.stage("upgrade", f"{one.where} from {one.found} to {one.spoken}"):
            try:
                _migrate(paths, one)
            except Exception as error:
                said = f"{type(error).__name__}: {hide_passwords(str(error).splitlines()[0])}"
                place = f"the copy is {paths.show(copy)}" if copy else "put your copy back"
                if one.store == "MLflow" and paths.storage is None:
                    file = paths.show(paths.tracking_database)
                    place += f"; if you remove {file}, it is written again from the records"
                raise InputError(f"the upgrade of {one.where} failed ({said}); {place}") from error
    kept = f", the copy is {paths.show(copy)} ({readable(copy.stat().st_size)})" if copy else ""
    return f"{one.where} from {one.found} to {one.spoken}{kept}"


def _migrate(paths: ProjectPaths, one: Version) -> None:
    if one.store == "Optuna":
        upgrade_optuna(paths)
        return
    with connected(paths.tracking_uri) as connection, connection.begin():
        config = migrations_of(one.store)
        config.attributes["connection"] = connection
        command.upgrade(config, "heads")


def _keep_copy(paths: ProjectPaths, one: Version) -> Path:
    """Copy a database aside, and only then give the copy its name."""
    folder = paths.mlruns / COPIES
    folder.mkdir(parents=True, exist_ok=True)
    moment = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
    ending = "db" if paths.storage is None else "sql"
    copy = folder / f"{one.store.lower()}-{one.found}-{moment}.{ending}"
    scratch = copy.with_name(f".{copy.name}-new")
    scratch.unlink(missing_ok=True)
    if paths.storage is None:
        with (
            closing(sqlite3.connect(paths.tracking_database)) as source,
            closing(sqlite3.connect(scratch)) as target,
        ):
            source.backup(target)
    else:
        _dump(paths.storage, one.store.lower(), scratch)
    scratch.rename(copy)
    return copy


def _dump(storage: str, schema: str, file: Path) -> None:
    """Write a schema of a PostgreSQL database to a file; the password goes by the environment."""
    advice = f"dump it yourself (pg_dump --schema={schema}), then type: studies doctor --upgrade --copied"
    program = shutil.which("pg_dump")
    if program is None:
        raise InputError(f"there is no pg_dump to keep a copy of the database's schema {schema}; {advice}")
    parts = urlsplit(storage)
    user, _, place = parts.netloc.rpartition("@")
    name, _, password = user.partition(":")
    netloc = f"{name}@{place}" if user else place
    shown = f"{parts.scheme}://{netloc}{parts.path}" + (f"?{parts.query}" if parts.query else "")
    environment = dict(os.environ)
    if password:
        environment["PGPASSWORD"] = unquote(password)
    called = subprocess.run(
        [program, f"--schema={schema}", f"--file={file}", "--no-password", shown],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if called.returncode:
        said = (called.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise InputError(f"pg_dump cannot keep a copy of the schema {schema} ({said}); {advice}")
