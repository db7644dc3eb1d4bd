"""Where a result stands in MLflow, asked of its database directly: importing MLflow would take seconds."""

import sqlite3
from contextlib import closing, suppress
from dataclasses import dataclass

from studies.paths import ProjectPaths

KEYS = ("trial_key", "study_key", "stage_key")
"""Tags by which this project knows its runs; a trial's run has the first two."""

_BY_TAG = "SELECT run_uuid FROM tags WHERE key = ? AND value = ?"
_BY_ID = "SELECT run_uuid FROM runs WHERE run_uuid LIKE ? || '%' AND lifecycle_stage = 'active'"
_RUN = "SELECT experiment_id, name, status FROM runs WHERE run_uuid = ? AND lifecycle_stage = 'active'"
_TAGS = "SELECT key, value FROM tags WHERE run_uuid = ?"


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
    if paths.storage is not None or not paths.tracking_database.is_file():
        return []
    place = f"{paths.tracking_database.resolve().as_uri()}?mode=ro"
    with suppress(sqlite3.Error), closing(sqlite3.connect(place, uri=True, timeout=2.0)) as database:
        found = database.execute(_BY_ID, (run_id,)) if run_id else database.execute(_BY_TAG, tag)
        runs = [address for (one,) in found.fetchall() for address in _address(database, one)]
        return [run for run in runs if role in ("", run.role)]
    return []


def _address(database: sqlite3.Connection, run_id: str) -> list[RunAddress]:
    tags = dict(database.execute(_TAGS, (run_id,)).fetchall())
    keys = tuple(tags[name] for name in KEYS if name in tags)
    found = database.execute(_RUN, (run_id,)).fetchall()
    role = tags.get("role", "")
    return [RunAddress(run_id, str(where), name, status, role, keys) for where, name, status in found]
