"""MLflow's tables, read directly: what an examination asks would take MLflow's own interface minutes."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

from sqlalchemy import create_engine, inspect, make_url, text
from sqlalchemy.engine import Connection
from sqlalchemy.exc import DBAPIError

from simulation.errors import InputError, MachineError
from studies.paths import ProjectPaths
from studies.storage_url import hide_passwords
from studies.tracking.tracker import cure_of

_TAGS = ("role", "trial_key", "study_key", "stage_key", "state", "whole", "owner", "label", "told")
_PLACES = (
    ("experiments", "artifact_location"),
    ("runs", "artifact_uri"),
    ("model_versions", "source"),
    ("model_versions", "storage_location"),
)
"""Columns in which MLflow keeps absolute places of files."""


@dataclass(frozen=True)
class RunRow:
    """A run.

    Args:
        run_id: its id.
        name: its name.
        status: how it ended.
        is_deleted: whether it waits for its end in MLflow's bin.
        artifact_uri: where its files are said to lie.
        label: its experiment's name.
        started_ms: its start. [ms since 1970]
        deleted_ms: when it was deleted. [ms since 1970]
        value: its metric `val/mae`.
        numbers: all metrics of a calibration, its uncertainty or Sobol indices.
        tags: those of its tags by which this project knows it.
    """

    run_id: str
    name: str
    status: str
    is_deleted: bool
    artifact_uri: str
    label: str
    started_ms: int
    deleted_ms: int
    value: float | None
    numbers: dict[str, float]
    tags: dict[str, str]

    @property
    def role(self) -> str:
        """What it shows: a study, a trial, a stage."""
        return self.tags.get("role", "")

    @property
    def folder(self) -> Path | None:
        """Folder of its files, None where they are no files."""
        return local_folder(self.artifact_uri)


@dataclass(frozen=True)
class VersionRow:
    """A version of a registered model.

    Args:
        model: the model's name.
        version: its number.
        source: where its files are said to lie.
        run_id: the run it came from.
        aliases: what points at it.
        identity: which surrogate it is, as the registry's tag says.
        created_s: when it was registered. [s since 1970, UTC]
    """

    model: str
    version: int
    source: str
    run_id: str
    aliases: tuple[str, ...]
    identity: str
    created_s: float


@dataclass(frozen=True)
class MlflowContent:
    """What MLflow's database holds of this project.

    Args:
        runs: all runs, deleted ones included, the earliest first.
        versions: all versions of all registered models.
        dangling: pairs of model and alias that point at no version.
        places: experiments with the folder of their files.
    """

    runs: tuple[RunRow, ...]
    versions: tuple[VersionRow, ...]
    dangling: tuple[tuple[str, str], ...]
    places: dict[str, str] = field(default_factory=dict)

    @property
    def active(self) -> list[RunRow]:
        """The runs that a user sees."""
        return [run for run in self.runs if not run.is_deleted]

    def of_role(self, role: str) -> list[RunRow]:
        """Return the visible runs that show one kind of thing."""
        return [run for run in self.active if run.role == role]


def read_mlflow(paths: ProjectPaths) -> MlflowContent:
    """Read everything; changes nothing."""
    with opened(paths) as connection:
        return MlflowContent(
            _runs(connection),
            _versions(connection),
            _dangling(connection),
            dict(_rows(connection, "SELECT name, artifact_location FROM experiments")),
        )


def experiment_names(paths: ProjectPaths) -> list[str]:
    """Return the labels that MLflow knows."""
    with opened(paths) as connection:
        if not inspect(connection).has_table("experiments"):
            return []
        found = _rows(connection, "SELECT name FROM experiments WHERE lifecycle_stage = 'active'")
    return sorted(name for (name,) in found if name != "Default")


def moved_places(paths: ProjectPaths, content: MlflowContent) -> dict[str, str]:
    """Return folders that MLflow remembers and that lie elsewhere now: old place to new place.

    A place counts as moved where this project has the experiment's folder. On a server that machines share
    it may be another machine's, and must not be there at all.
    """
    found = {}
    for label, place in content.places.items():
        folder, here = local_folder(place), paths.artifacts.resolve() / label
        if folder is None or folder.resolve() == here or not here.is_dir():
            continue
        if paths.storage is None or not folder.is_dir():
            found[place] = here.as_uri()
    return found


def rewrite_places(paths: ProjectPaths, moved: dict[str, str]) -> int:
    """Tell MLflow where folders lie now; return the number of places that were rewritten."""
    n_rewritten = 0
    with opened(paths) as connection, connection.begin():
        for old, new in moved.items():
            for table, column in _PLACES:
                statement = text(
                    f"UPDATE {table} SET {column} = :new || substr({column}, :after) "
                    f"WHERE {column} = :old OR substr({column}, 1, :length) = :slashed"
                )
                done = connection.execute(
                    statement,
                    {
                        "old": old,
                        "new": new,
                        "after": len(old) + 1,
                        "length": len(old) + 1,
                        "slashed": f"{old}/",
                    },
                )
                n_rewritten += done.rowcount
    return n_rewritten


@contextmanager
def opened(paths: ProjectPaths) -> Iterator[Connection]:
    """Open a connection to MLflow's database."""
    with connected(paths.tracking_uri) as connection:
        yield connection


@contextmanager
def connected(url: str) -> Iterator[Connection]:
    """Open a connection to a database by its URL.

    Raises:
        InputError: it cannot be read.
        MachineError: it is locked, or its disk cannot be used.
    """
    engine = create_engine(make_url(url))
    try:
        with engine.connect() as connection:
            yield connection
    except DBAPIError as error:
        said = hide_passwords(str(error.orig).splitlines()[0])
        line, cure = f"MLflow's or Optuna's database cannot be read ({said})", cure_of(said)
        raise (MachineError(f"{line}; {cure}") if cure else InputError(line)) from error
    finally:
        engine.dispose()


def local_folder(place: str) -> Path | None:
    """Return the folder that a place of MLflow's means, None where it is no folder of a file system."""
    parts = urlparse(place)
    return Path(unquote(parts.path)) if parts.scheme in ("", "file") else None


def _runs(connection: Connection) -> tuple[RunRow, ...]:
    tags: dict[str, dict[str, str]] = {}
    names = ", ".join(f"'{name}'" for name in _TAGS)
    for run_id, key, value in _rows(
        connection, f"SELECT run_uuid, key, value FROM tags WHERE key IN ({names})"
    ):
        tags.setdefault(run_id, {})[key] = value
    numbers: dict[str, dict[str, float]] = {}
    for run_id, key, value in _rows(
        connection,
        "SELECT m.run_uuid, m.key, m.value FROM latest_metrics m JOIN tags t ON t.run_uuid = m.run_uuid "
        "WHERE t.key = 'role' AND t.value IN ('calibration', 'sensitivity', 'uncertainty')",
    ):
        numbers.setdefault(run_id, {})[key] = float(value)
    found = _rows(
        connection,
        "SELECT r.run_uuid, r.name, r.status, r.lifecycle_stage, r.artifact_uri, e.name, r.start_time, "
        "r.deleted_time, m.value FROM runs r JOIN experiments e ON e.experiment_id = r.experiment_id "
        "LEFT JOIN latest_metrics m ON m.run_uuid = r.run_uuid AND m.key = 'val/mae' ORDER BY r.start_time",
    )
    return tuple(
        RunRow(
            run_id=run_id,
            name=name or "",
            status=status,
            is_deleted=stage == "deleted",
            artifact_uri=uri or "",
            label=label,
            started_ms=int(started or 0),
            deleted_ms=int(deleted or 0),
            value=None if value is None else float(value),
            numbers=numbers.get(run_id, {}),
            tags=tags.get(run_id, {}),
        )
        for run_id, name, status, stage, uri, label, started, deleted, value in found
    )


def _versions(connection: Connection) -> tuple[VersionRow, ...]:
    aliases: dict[tuple[str, int], list[str]] = {}
    for model, version, alias in _rows(
        connection, "SELECT name, version, alias FROM registered_model_aliases"
    ):
        aliases.setdefault((model, int(version)), []).append(alias)
    identities = {
        (model, int(version)): value
        for model, version, value in _rows(
            connection,
            "SELECT name, version, value FROM model_version_tags WHERE key = 'champion_sha256'",
        )
    }
    found = _rows(
        connection,
        "SELECT name, version, source, run_id, creation_time FROM model_versions "
        "WHERE current_stage <> 'Deleted_Internal' ORDER BY name, version",
    )
    return tuple(
        VersionRow(
            model,
            int(version),
            source or "",
            run_id or "",
            tuple(sorted(aliases.get((model, int(version)), []))),
            identities.get((model, int(version)), ""),
            (created_ms or 0) / 1000.0,
        )
        for model, version, source, run_id, created_ms in found
    )


def _dangling(connection: Connection) -> tuple[tuple[str, str], ...]:
    found = _rows(
        connection,
        "SELECT a.name, a.alias FROM registered_model_aliases a LEFT JOIN model_versions v "
        "ON v.name = a.name AND v.version = a.version AND v.current_stage <> 'Deleted_Internal' "
        "WHERE v.version IS NULL",
    )
    return tuple((model, alias) for model, alias in found)


def _rows(connection: Connection, statement: str) -> list[tuple[Any, ...]]:
    return [tuple(row) for row in connection.execute(text(statement))]
