"""Which version of its schema every store has, and which one this installation speaks."""

import importlib.util
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version as installed
from pathlib import Path
from typing import Literal

from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory

from simulation.errors import InputError
from simulation.store.folder import MANIFEST
from simulation.store.folder import SCHEMA as STORE_SCHEMA
from studies.keeping.entries import undescribed
from studies.keeping.finding import StoreFinding, listed, ok
from studies.keeping.mlflow_tables import connected
from studies.paths import ProjectPaths
from studies.report.wording import count
from studies.storage_url import in_schema
from studies.tuning.champion import CHAMPION_FILE
from studies.tuning.champion import SCHEMA as CHAMPION_SCHEMA

STORE = "versions"
UPGRADE = "studies doctor --upgrade brings it up to date, after keeping a copy"
Standing = Literal["same", "behind", "ahead", "empty"]

_MIGRATIONS = {"MLflow": ("mlflow", "store/db_migrations"), "Optuna": ("optuna", "storages/_rdb/alembic")}


@dataclass(frozen=True)
class Version:
    """A store's version.

    Args:
        store: whose it is.
        where: the store, as a user may be told.
        found: its version.
        spoken: the version that this installation speaks.
        standing: same, behind or ahead of it, or empty where there is nothing yet.
    """

    store: str
    where: str
    found: str
    spoken: str
    standing: Standing


def versions_of(paths: ProjectPaths) -> list[Version]:
    """Return the versions of everything that has one; changes nothing."""
    found = _mlflow(paths)
    if paths.storage is not None:
        found.append(_database("Optuna", "the database's schema optuna", in_schema(paths.storage, "optuna")))
    for file in sorted((paths.mlruns / "champions").glob(f"*/*/{CHAMPION_FILE}")):
        found += _numbered("champion", paths, file, CHAMPION_SCHEMA)
    for file in sorted(paths.data.glob(f"*/generated/simulations/*/{MANIFEST}")):
        found += _numbered("simulations", paths, file, STORE_SCHEMA)
    return found


def check_versions(paths: ProjectPaths, versions: Sequence[Version]) -> Iterator[StoreFinding]:
    """Say which stores are of another version."""
    n_bad = 0
    for one in versions:
        if one.standing == "behind":
            n_bad += 1
            said = f"is of version {one.found}, {one.store} {_library(one)}speaks {one.spoken}"
            remedy = UPGRADE if one.store in _MIGRATIONS else "remove the folder; studies run writes it again"
            yield StoreFinding(STORE, "bad", one.where, said, remedy)
        elif one.standing == "ahead":
            n_bad += 1
            said = f"was written by a newer version ({one.found}; this one speaks {one.spoken})"
            library = one.store.lower() if one.store in _MIGRATIONS else "the program"
            yield StoreFinding(
                STORE, "bad", one.where, said, f"install a newer {library}; nothing is changed"
            )
    folders = undescribed(paths)
    if folders:
        n_bad += 1
        said = f"{count(len(folders), 'study', 'studies')} of an earlier version, without a description"
        names = listed([paths.show(folder) for folder in folders])
        yield StoreFinding(
            STORE, "bad", names, said, "studies doctor --upgrade describes them from their trials"
        )
    if not n_bad:
        spoken = {f"{one.store} {one.found}" for one in versions if one.store in _MIGRATIONS}
        yield ok(STORE, "all stores", ", ".join(["as installed", *sorted(spoken)]))


def is_readable(version: Version) -> bool:
    """Return whether this installation can read the store."""
    return version.standing in ("same", "empty")


def require_mlflow_version(paths: ProjectPaths) -> None:
    """Refuse a database of MLflow's that another version wrote.

    MLflow itself would bring one of an earlier version up to date on the way, without a copy and for good.

    Raises:
        InputError: it is of an earlier or a later version.
    """
    for one in _mlflow(paths):
        if one.standing == "behind":
            raise InputError(
                f"{one.where} is of version {one.found}, MLflow {_library(one)}speaks {one.spoken}; "
                "type: studies doctor --upgrade (it keeps a copy)"
            )
        if one.standing == "ahead":
            raise InputError(
                f"{one.where} was written by a newer MLflow (version {one.found}); install a newer mlflow"
            )


def _mlflow(paths: ProjectPaths) -> list[Version]:
    if paths.storage is None and not paths.tracking_database.is_file():
        return []
    where = "the database's schema mlflow" if paths.storage else paths.show(paths.tracking_database)
    return [_database("MLflow", where, paths.tracking_uri)]


def migrations_of(store: str) -> Config:
    """Return the migrations that came with a library."""
    package, place = _MIGRATIONS[store]
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    folder = Path(spec.origin).parent / place
    config = Config()
    config.set_main_option("script_location", str(folder).replace("%", "%%"))
    return config


def _database(store: str, where: str, url: str) -> Version:
    scripts = ScriptDirectory.from_config(migrations_of(store))
    spoken = scripts.get_current_head() or ""
    try:
        with connected(url) as connection:
            found = MigrationContext.configure(connection).get_current_revision()
    except InputError:  # said where its content is compared
        return Version(store, where, "", spoken, "empty")
    if found is None:
        return Version(store, where, "", spoken, "empty")
    if found == spoken:
        return Version(store, where, found, spoken, "same")
    known = {script.revision for script in scripts.walk_revisions()}
    return Version(store, where, found, spoken, "behind" if found in known else "ahead")


def _numbered(store: str, paths: ProjectPaths, file: Path, spoken: int) -> Iterator[Version]:
    try:
        found = json.loads(file.read_text(encoding="utf-8"))["schema"]
    except (OSError, ValueError, KeyError, TypeError):  # damaged, which others say
        return
    if isinstance(found, int) and found != spoken:
        standing: Standing = "behind" if found < spoken else "ahead"
        yield Version(store, paths.show(file), str(found), str(spoken), standing)


def _library(one: Version) -> str:
    return f"{installed(one.store.lower())} " if one.store in _MIGRATIONS else ""
