"""What tests of tuning compare."""

from typing import Any

import optuna
from optuna.storages import RDBStorage

from studies.paths import ProjectPaths
from studies.tuning.study_spec import StudySpec, TuneEvent
from studies.tuning.study_store import StudyStore, open_optuna
from studies.tuning.trial_record import TrialRecord
from studies.tuning.trial_store import open_trials
from studies.tuning.trial_worker import run_study


def ignore(event: TuneEvent) -> None:
    """Listen to nothing."""


def essence(records: list[TrialRecord]) -> list[tuple[object, ...]]:
    """Return what must not depend on interruptions."""
    return [(r.index, r.state, r.params, r.seed, r.metrics, r.reports, r.n_epochs) for r in records]


def in_optuna(spec: StudySpec, paths: ProjectPaths) -> list[optuna.trial.FrozenTrial]:
    """Read a study's trials from Optuna's store."""
    storage = open_optuna(paths)
    trials = optuna.load_study(study_name=spec.name, storage=storage).get_trials()
    if isinstance(storage, RDBStorage):
        storage.engine.dispose()
    return trials


def run_and_tell(spec: StudySpec, paths: ProjectPaths, n_trials: int, **more: Any) -> None:
    """Run a study in this process, and tell Optuna as a command does."""
    run_study(spec, paths=paths, n_trials=n_trials, emit=more.pop("emit", ignore), **more)
    store = StudyStore(spec, paths)
    store.tell(open_trials(paths, spec))
    store.close()


def records_of(spec: StudySpec, paths: ProjectPaths) -> list[TrialRecord]:
    """Read a study's records."""
    return open_trials(paths, spec).records()
