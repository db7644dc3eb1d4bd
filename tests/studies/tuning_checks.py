"""What tests of tuning compare."""

from pathlib import Path

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend

from studies.tuning.study_spec import StudySpec, TuneEvent
from studies.tuning.trial_record import TrialRecord


def ignore(event: TuneEvent) -> None:
    """Listen to nothing."""


def essence(records: list[TrialRecord]) -> list[tuple[object, ...]]:
    """Return what must not depend on interruptions."""
    return [(r.index, r.state, r.params, r.seed, r.metrics, r.reports, r.n_epochs) for r in records]


def in_journal(spec: StudySpec, mlruns: Path) -> list[optuna.trial.FrozenTrial]:
    """Read a study's trials as any Optuna user would."""
    storage = JournalStorage(JournalFileBackend(str(mlruns / "optuna.journal")))
    return optuna.load_study(study_name=spec.name, storage=storage).get_trials()
