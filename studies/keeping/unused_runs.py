"""What MLflow holds and nothing needs: deleted runs, runs without records, superseded model versions."""

import re
import shutil
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from studies.keeping.ghosts import is_worked_on
from studies.keeping.leftover import Leftover, of_place
from studies.keeping.mlflow_tables import MlflowContent, RunRow, VersionRow, local_folder, read_mlflow
from studies.keeping.scratch import size_of
from studies.keeping.stores import Stores
from studies.keeping.views import remove_folder, tracker_of

_RUN_FOLDER = re.compile(r"[0-9a-f]{32}")


def unused_runs(stores: Stores) -> Iterator[Leftover]:
    """Find runs, models and their files that may go."""
    paths = stores.paths
    if paths.storage is None and not paths.tracking_database.is_file():
        return
    content = read_mlflow(paths)
    busy = {study.name for study in stores.studies if study.is_busy}
    for run in content.runs:
        if run.is_deleted:
            yield _run(stores, run, "deleted runs", "in MLflow's bin", run.deleted_ms / 1000.0)
        elif _is_orphan(stores, run) and not (run.status == "RUNNING" and is_worked_on(run, busy)):
            why = f"{run.tags['study_key']} has no records"
            yield _run(stores, run, "runs without records", why, run.started_ms / 1000.0)
    yield from _versions(stores, content)
    known = {run.run_id for run in content.runs}
    for folder in sorted(paths.artifacts.glob("*/*/")):
        if _RUN_FOLDER.fullmatch(folder.name) and folder.name not in known:
            yield of_place("files of no run", folder, paths.show(folder), "MLflow knows no such run")


def _is_orphan(stores: Stores, run: RunRow) -> bool:
    return run.role in ("study", "trial") and run.tags.get("study_key", "") not in stores.by_name


def _run(stores: Stores, run: RunRow, kind: str, why: str, changed_s: float) -> Leftover:
    folder = _own_folder(stores, run.folder)
    size = size_of(folder) if folder is not None and folder.is_dir() else 0
    return Leftover(kind, f"{run.label}: {run.name}", why, size, changed_s, partial(_remove_run, stores, run))


def _own_folder(stores: Stores, folder: Path | None) -> Path | None:
    """Return a run's folder where it lies below this project's artifacts."""
    if folder is None or not folder.is_relative_to(stores.paths.artifacts.resolve()):
        return None
    return folder.parent if folder.name == "artifacts" else folder


def _remove_run(stores: Stores, run: RunRow) -> str:
    """Remove a run for good, its files last: without a run they are found as files of no run."""
    tracker = tracker_of(stores.paths)
    if not run.is_deleted:
        tracker.client.delete_run(run.run_id)
    tracker.client._tracking_client.store._hard_delete_run(run.run_id)
    folder = _own_folder(stores, run.folder)
    if folder is not None and folder.is_dir():
        remove_folder(folder)
    return ""


def _versions(stores: Stores, content: MlflowContent) -> Iterator[Leftover]:
    """Find versions of models that no alias points at."""
    for version in content.versions:
        if version.aliases or not _is_ours(version):
            continue
        others = [one for one in content.versions if one is not version]
        folder = local_folder(version.source)
        is_here = folder is not None and folder.is_dir()
        yield Leftover(
            "superseded models",
            f"{version.model} version {version.version}",
            "neither champion nor previous",
            size_of(folder) if folder is not None and is_here else 0,
            version.created_s,
            partial(_remove_version, stores, version, others),
        )


def _is_ours(version: VersionRow) -> bool:
    return bool(version.identity)


def _remove_version(stores: Stores, version: VersionRow, others: Sequence[VersionRow]) -> str:
    tracker_of(stores.paths).client.delete_model_version(version.model, str(version.version))
    folder = local_folder(version.source)
    is_ours = folder is not None and folder.is_relative_to(stores.paths.artifacts.resolve())
    if folder is not None and is_ours and not any(one.source == version.source for one in others):
        shutil.rmtree(folder, ignore_errors=True)
    return ""
