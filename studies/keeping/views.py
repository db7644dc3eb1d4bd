"""Write Optuna's and MLflow's views of the studies, and the champions, again from the records."""

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

from studies.keeping.stores import KeptStudy
from studies.keeping.versions import require_mlflow_version
from studies.paths import ProjectPaths
from studies.tracking.mlflow_tracker import MlflowTracker
from studies.tracking.tracker import History
from studies.tuning.champion import read_champion
from studies.tuning.trial_record import TrialRecord, summarize


@cache
def tracker_of(paths: ProjectPaths) -> MlflowTracker:
    """Return the way to the project's MLflow, opened once: it costs seconds.

    Raises:
        InputError: another version of MLflow wrote its database.
    """
    require_mlflow_version(paths)
    return MlflowTracker(paths)


def write_to_mlflow(study: KeptStudy) -> None:
    """Tell MLflow of a study, its trials and its champion; what it knows already stays.

    Raises:
        InputError: the champion cannot be read.
    """
    require_mlflow_version(study.paths)
    tracker = MlflowTracker(study.paths)  # a new one: it remembers runs that may have been removed since
    spec, store = study.spec, study.store
    tracker.start_study(spec, n_trials=len(study.records))
    for record in study.records:
        tracker.log_trial(spec, record, _history(study, record))
    champion = study.paths.champion(spec.label, spec.n_train)
    is_champion = False
    if (champion / "champion.json").is_file():
        is_champion = read_champion(champion).study == study.name
        if is_champion:
            tracker.register_champion(spec, champion)
    is_done = len(store.finished()) >= study.entry.n_planned
    summary = summarize(spec, study.records, champion if is_champion else None)
    tracker.finish_study(spec, summary, "FINISHED" if is_done else "KILLED")


def _history(study: KeptStudy, record: TrialRecord) -> Callable[[], History]:
    return lambda: study.store.history(record.index)


def remove_folder(folder: Path) -> None:
    """Remove a folder so that it is there as a whole or gone: first it gets a name nobody reads."""
    trash = folder.with_name(f".gone-{folder.name}")
    shutil.rmtree(trash, ignore_errors=True)
    folder.rename(trash)
    shutil.rmtree(trash)
