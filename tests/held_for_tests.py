"""What a project holds: the numbers, rows, trials and files that must be equal, and what must not be left."""

import contextlib
import hashlib
import json
import os
import re
import sqlite3
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy

REPOSITORY = Path(__file__).resolve().parents[1]
# Beside times and places: of the rows that a stage asked for, how many were stored before, and how many not.
COUNTS_OF_THIS_TIME = ("n_reused", "n_simulated")
VOLATILE = (
    "wall", "environment", "run_id", "finished", "provenance", "per_second", "_s", *COUNTS_OF_THIS_TIME,
)  # fmt: skip


def begun_in(
    project: Path,
    words: tuple[str, ...],
    scratch: Path,
    own: Mapping[str, str],
    *,
    before: tuple[str, ...] = (),
) -> "subprocess.Popen[str]":
    """Begin a command in a project, with a temporary folder and variables of its own.

    Args:
        project: Where it is typed.
        words: The command.
        scratch: Its temporary folder, which is made.
        own: More of its environment.
        before: A program that starts it.
    """
    scratch.mkdir(exist_ok=True)
    return subprocess.Popen(
        [*before, sys.executable, "-P", "-m", "studies", *words],
        cwd=project,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY), "TMPDIR": str(scratch), **own},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def numbers_of(value: Any) -> Any:
    """Return a record without what differs each time."""
    if isinstance(value, dict):
        return {k: numbers_of(v) for k, v in value.items() if not k.endswith(VOLATILE) and "wall" not in k}
    return [numbers_of(one) for one in value] if isinstance(value, list) else value


def record_of(content: dict[str, Any]) -> Any:
    """Return what must be equal of a record, or of a stage's manifest."""
    if "stage" not in content:
        return numbers_of(content)
    if content["stage"] == "check":
        # It says how long a simulation took, "0.461 ms per simulation", and how many fitted into a time.
        for finding in content["result"]["findings"]:
            finding["found"] = re.sub(r"[\d.]+ (ms|s|min|h|simulations)\b", "some", finding["found"])
    # The report's digest is one of whole files, measured times included: it differs without a kill as well.
    parts = ("stage", "result") if content["stage"] == "report" else ("stage", "result", "digest")
    return numbers_of({part: content[part] for part in parts})


def differences(one: Any, other: Any, place: str = "") -> Iterator[str]:
    """Say where two records differ."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in sorted({*one, *other}, key=str):
            yield from differences(one.get(key), other.get(key), f"{place}/{key}")
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for number, pair in enumerate(zip(one, other, strict=True)):
            yield from differences(*pair, f"{place}[{number}]")
    elif one != other and not (one != one and other != other):  # NaN is NaN
        yield f"{place} is {str(other)[:200]}, not {str(one)[:200]}"


def held(project: Path, url: str | None = None) -> dict[str, Any]:
    """Return the numbers, rows, trials and files that a project holds.

    Args:
        project: Its folder.
        url: Its database on a PostgreSQL server; None: it has files.
    """
    from studies.paths import ProjectPaths
    from studies.tuning.storage import storage_of

    found: dict[str, Any] = {}
    for file in sorted((project / "mlruns" / "results").rglob("*")):
        name = str(file.relative_to(project))
        if file.suffix == ".json":
            found[name] = record_of(json.loads(file.read_text()))
        elif file.suffix == ".npz":
            with np.load(file) as arrays:
                found[name] = {
                    key: hashlib.sha256(arrays[key].tobytes()).hexdigest()
                    for key in arrays.files
                    if not key.endswith(VOLATILE)
                }
    given = [file for place in ("fmus", "data") for file in (project / place).rglob("*")]
    for file in [*given, *(project / "mlruns" / "reports").rglob("*")]:
        if file.is_file() and "generated" not in file.parts:
            content = hashlib.sha256(file.read_bytes()).hexdigest() if file in given else "there"
            found.setdefault(str(file.relative_to(project)), content)
    rows = set[tuple[Any, ...]]()
    for file in (project / "data").rglob("*.db"):
        with contextlib.closing(sqlite3.connect(file)) as database:
            # The checksum is one of the parameters, the failure and all outputs.
            query = "select _theta, _failure, _check from simulations"
            rows |= {(file.name, *row) for row in database.execute(query)}
    found["rows"] = rows
    if url or (project / "mlruns" / "optuna.db").is_file():
        with storage_of(ProjectPaths(project, url)) as storage:
            for study in storage.get_all_studies():
                trials = storage.get_all_trials(study._study_id)
                ended = [one for one in trials if one.state.is_finished() and one.state.name != "FAIL"]
                found[f"trials of {study.study_name}"] = sorted(
                    (str(sorted(one.params.items())), one.state.name, str(one.values)) for one in ended
                )
    return found


def open_runs(project: Path, url: str | None = None) -> list[str]:
    """Return the names of MLflow's runs that have not ended, in files or in a database on a server."""
    if not (url or (project / "mlruns" / "mlflow.db").is_file()):
        return []
    from studies.paths import ProjectPaths

    engine = sqlalchemy.create_engine(ProjectPaths(project, url).tracking_uri)
    with contextlib.closing(engine.connect()) as database:
        if not sqlalchemy.inspect(database).has_table("runs"):
            return []
        query = "SELECT name FROM runs WHERE status = 'RUNNING' AND lifecycle_stage = 'active'"
        names = [str(name) for (name,) in database.execute(sqlalchemy.text(query))]
    engine.dispose()
    return names


def half_files(project: Path, scratch: Path) -> list[str]:
    """Return what should not be there once a command has ended."""
    left = [str(file) for file in scratch.iterdir()] if scratch.is_dir() else []
    names = ("*.tmp", "*.part", "*.partial", "*-making", "*.db-journal")
    return left + [str(one) for name in names for one in project.rglob(name)]


def wrong_of(after: dict[str, Any], now: dict[str, Any]) -> list[str]:
    """Say what a project lacks, or has otherwise, of what it should hold."""
    lost = after["rows"] - now["rows"]
    return [f"{len(lost)} rows lost"] * bool(lost) + [*differences(after | {"rows": 0}, now | {"rows": 0})]
