"""MLflow's SQLite file, which may be a stranger's: all that it names lies in the project.

MLflow writes and reads artifacts wherever a run says, as `file:///...` or by HTTP.
"""

import sqlite3
from contextlib import closing
from pathlib import Path

from simulation.errors import InputError
from simulation.foreign_text import quoted
from simulation.write_gate import FOLLOW_VARIABLE, follows_links

SCHEME = "studies-project"
"""Of artifacts that lie in the project, see `studies.tracking.artifacts`."""
_PATIENCE_S = 60.0  # for another process that writes; it does so in milliseconds


def _outside(table: str, column: str, more: str = "") -> str:
    """Return the query for a place of a table that is not the project's."""
    return f"select {column} from {table} where {column} not like '{SCHEME}:/%' {more} limit 1"


# What may name another place: table, what it holds, and the query. Earlier versions of MLflow have fewer.
_PLACES = (
    # MLflow makes the experiment Default itself, with a folder that nothing here uses.
    (
        "experiments",
        "an experiment",
        _outside(
            "experiments", "artifact_location", "and (name <> 'Default' or artifact_location like '%://%')"
        ),
    ),
    ("runs", "a run", _outside("runs", "artifact_uri")),
    ("logged_models", "a model", _outside("logged_models", "artifact_location")),
    (
        "model_versions",
        "a model version",
        # What MLflow writes in place of the source of a version that was deleted.
        _outside(
            "model_versions", "source", "and source not like 'models:/%' and source <> 'REDACTED-SOURCE-PATH'"
        ),
    ),
    ("model_versions", "a model version", _outside("model_versions", "storage_location")),
    ("webhooks", "a webhook", "select url from webhooks limit 1"),
)
# Statements that SQLite runs on its own. MLflow makes one trigger, which protects its secrets.
_STATEMENTS = "select name from sqlite_master where type in ('trigger', 'view') and tbl_name <> 'secrets'"


def check_store(file: Path) -> None:
    """Refuse a store whose artifacts lie outside the project; the user may allow that.

    Args:
        file: An SQLite file of MLflow.

    Raises:
        sqlite3.Error: If the file cannot be read.
        InputError: If it names another place, or holds statements that would change what it names.
    """
    if follows_links():
        return
    # It may be written: with a journal beside it, what it names is known once that is rolled back.
    with closing(sqlite3.connect(file, timeout=_PATIENCE_S)) as store:
        found = store.execute(_STATEMENTS).fetchone()
        if found is not None:
            raise InputError(
                f"{file}: the trigger or view {quoted(found[0])} is not MLflow's; do not use this file"
            )
        tables = {name for (name,) in store.execute("select name from sqlite_master where type = 'table'")}
        for table, what, query in _PLACES:
            found = store.execute(query).fetchone() if table in tables else None
            if found is not None:
                raise InputError(
                    f"{file}: {what} names {quoted(found[0])}, which is not in this project; do not use "
                    f"this file, or allow such places if they are yours: {FOLLOW_VARIABLE}=1"
                )
