"""Where a result stands in MLflow, asked of its database directly: importing MLflow would take seconds."""

import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

from simulation.errors import InputError
from studies.paths import ProjectPaths

KEYS = ("trial_key", "study_key", "stage_key")
"""Tags by which this project knows its runs; a trial's run has the first two."""

_BY_TAG = "SELECT run_uuid FROM {schema}tags WHERE key = ? AND value = ?"
_BY_ID = "SELECT run_uuid FROM {schema}runs WHERE substr(run_uuid, 1, ?) = ?"
_RUN = (
    "SELECT experiment_id, name, status FROM {schema}runs WHERE run_uuid = ? AND lifecycle_stage = 'active'"
)
_TAGS = "SELECT key, value FROM {schema}tags WHERE run_uuid = ?"


@dataclass(frozen=True)
class RunAddress:
    """A run of MLflow.

    Args:
        run_id: its id.
        experiment_id: its experiment's id.
        name: its name.
        status: how it ended.
        role: what it tells of: a study, a trial, a calibration, ...
        keys: this project's names of that, the narrowest first.
    """

    run_id: str
    experiment_id: str
    name: str
    status: str
    role: str
    keys: tuple[str, ...]

    @property
    def page(self) -> str:
        """Its page in MLflow's user interface, behind the address that `studies ui` prints."""
        return f"/#/experiments/{self.experiment_id}/runs/{self.run_id}"


def find_runs(
    paths: ProjectPaths, *, run_id: str = "", tag: tuple[str, str] = ("", ""), role: str = ""
) -> list[RunAddress]:
    """Return runs by the beginning of their id, or by a tag; none where there is no readable database.

    Args:
        paths: the project.
        run_id: first digits of the id.
        tag: name and value of a tag, looked for where no id is given.
        role: only runs of this role; all where it is empty.
    """
    try:
        found = _ask(paths, _BY_ID, (len(run_id), run_id)) if run_id else _ask(paths, _BY_TAG, tag)
        runs = [address for (one,) in found for address in _address(paths, one)]
    except (sqlite3.Error, InputError):
        return []
    return [run for run in runs if role in ("", run.role)]


def _address(paths: ProjectPaths, run_id: str) -> list[RunAddress]:
    tags = {str(name): str(value) for name, value in _ask(paths, _TAGS, (run_id,))}
    keys = tuple(tags[name] for name in KEYS if name in tags)
    found, role = _ask(paths, _RUN, (run_id,)), tags.get("role", "")
    return [RunAddress(run_id, str(where), name, status, role, keys) for where, name, status in found]


def _ask(paths: ProjectPaths, statement: str, values: Sequence[Any]) -> Sequence[Sequence[Any]]:
    """Run a statement on MLflow's database; one that is not there yet has no rows."""
    if paths.storage is not None:
        from studies.tuning.postgres import database

        return database(paths.storage).rows(statement.format(schema="mlflow.").replace("?", "%s"), values)
    if not paths.tracking_database.is_file():
        return []
    place = f"{paths.tracking_database.resolve().as_uri()}?mode=ro"
    with closing(sqlite3.connect(place, uri=True, timeout=2.0)) as connection:
        return connection.execute(statement.format(schema=""), values).fetchall()
