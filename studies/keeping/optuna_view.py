"""Optuna's view of the studies: what it says of each trial, and writing it again from the records."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import optuna
from optuna.storages import BaseStorage, RDBStorage
from optuna.trial import TrialState as OptunaState

from studies.keeping.stores import KeptStudy
from studies.paths import ProjectPaths
from studies.storage_url import in_schema
from studies.tuning.study_store import JOURNAL, StudyStore, open_optuna

_STATES = {
    OptunaState.COMPLETE: "complete",
    OptunaState.PRUNED: "pruned",
    OptunaState.FAIL: "failed",
    OptunaState.RUNNING: "running",
    OptunaState.WAITING: "waiting",
}


@dataclass(frozen=True)
class OptunaTrial:
    """A trial as Optuna has it.

    Args:
        number: Optuna's own number.
        index: its place in the study, -1 where it does not say.
        state: complete, pruned, failed, running or waiting.
        value: its validation error.
    """

    number: int
    index: int
    state: str
    value: float | None


def has_optuna(paths: ProjectPaths) -> bool:
    """Return whether there is a store of Optuna's at all."""
    return paths.storage is not None or (paths.mlruns / JOURNAL).is_file()


def read_optuna(paths: ProjectPaths) -> dict[str, list[OptunaTrial]]:
    """Return all trials of all studies, by study.

    Raises:
        InputError: the store is damaged, of another version, or away.
    """
    if not has_optuna(paths):
        return {}
    found = {}
    with _opened(paths) as storage:
        studies = storage.get_all_studies()
        content = {one.study_name: storage.get_all_trials(one._study_id, deepcopy=False) for one in studies}
    for name, trials in content.items():
        found[name] = [
            OptunaTrial(
                number=trial.number,
                index=int(trial.user_attrs.get("index", -1)),
                state=_STATES[trial.state],
                value=trial.values[0] if trial.values else None,
            )
            for trial in trials
        ]
    return found


def rebuild_optuna(study: KeptStudy) -> None:
    """Write one study again from its records."""
    forget_optuna(study.paths, study.name)
    StudyStore(study.spec, study.paths).tell(study.store)


def forget_optuna(paths: ProjectPaths, name: str) -> bool:
    """Remove one study; return whether there was one."""
    if not has_optuna(paths):
        return False
    with _opened(paths) as storage:
        if name not in {study.study_name for study in storage.get_all_studies()}:
            return False
        optuna.delete_study(study_name=name, storage=storage)
    return True


@contextmanager
def _opened(paths: ProjectPaths) -> Iterator[BaseStorage]:
    """Open Optuna's store, and hang up on a server at the end."""
    storage = open_optuna(paths)
    try:
        yield storage
    finally:
        storage.remove_session()
        if isinstance(storage, RDBStorage):
            storage.engine.dispose()


def upgrade_optuna(paths: ProjectPaths) -> None:
    """Bring the tables of Optuna's database up to date."""
    assert paths.storage is not None
    url = in_schema(paths.storage, "optuna")
    # Without any handler Optuna's migrations set up logging of their own, which tells of every step.
    silence = logging.NullHandler()
    logging.getLogger().addHandler(silence)
    try:
        RDBStorage(url, skip_compatibility_check=True, skip_table_creation=True).upgrade()
    finally:
        logging.getLogger().removeHandler(silence)
