"""Optuna's storage: opened, its studies made and found, trials of dead workers given to whoever comes next.

A place is a trial and the retries of it: a study of 20 trials has 20 places, however often a worker died.
"""

import copy
import hashlib
import sqlite3
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Any

import optuna
from optuna.storages import RDBStorage, RetryHeartbeatStaleTrialCallback
from optuna.trial import FrozenTrial, TrialState

from simulation.errors import InputError, MachineError
from simulation.file_lock import FileLock
from studies.paths import ProjectPaths, cannot_open
from studies.storage_url import hide_passwords
from studies.tuning.declaration import Declaration
from studies.tuning.owner import is_dead, this_process

HEARTBEAT_S, GRACE_S = 10, 30
MAX_RETRIES = 5
"""Of a trial whose worker dies; a trial that kills its worker again and again fails."""
DECLARATION, PLANNED, OWNER, RUN_ID = "declaration", "n_trials", "owner", "mlflow_run_id"
CLOSED = "closed"
"""Attribute of a study: how many trials it had when its best surrogate was registered."""
PROPOSED_BY, SEED = "proposed_by", "seed"
"""Attribute of a trial whose hyperparameters are all chosen."""

optuna.logging.set_verbosity(optuna.logging.ERROR)
warnings.filterwarnings("ignore", category=optuna.exceptions.ExperimentalWarning)


def open_storage(paths: ProjectPaths) -> RDBStorage:
    """Open the project's Optuna storage, making it where there is none.

    Raises:
        InputError: the storage refuses or is no database of Optuna.
        MachineError: it does not answer.
    """
    paths.mlruns.mkdir(parents=True, exist_ok=True)
    try:
        # Two processes that make the tables at the same moment would get in each other's way.
        with FileLock(paths.mlruns / ".optuna.lock"):
            if paths.storage is None:
                _prepare_sqlite(paths)
            else:
                _prepare_schemas(paths.storage)
            storage = RDBStorage(
                paths.optuna_url,
                engine_kwargs={"connect_args": {"timeout": 60}}
                if paths.storage is None
                else {"pool_pre_ping": True},
                heartbeat_interval=HEARTBEAT_S,
                grace_period=GRACE_S,
                heartbeat_stale_trial_callback=run_again,
            )
    except (InputError, OSError):
        raise
    except Exception as error:
        raise cannot_open(paths, "Optuna", paths.optuna_database, error) from None
    if paths.storage is None:
        from sqlalchemy import event

        # A power cut may lose the last trial, never the file: an eighth of the time of a full sync.
        event.listen(storage.engine, "connect", lambda one, _: one.execute("pragma synchronous=normal"))
    return storage


@contextmanager
def storage_of(paths: ProjectPaths) -> Iterator[RDBStorage]:
    """Open the project's Optuna storage, and close its connections at the end.

    Yields:
        the storage.
    """
    storage = open_storage(paths)
    try:
        yield storage
    finally:
        storage.remove_session()
        storage.engine.dispose()


def _prepare_sqlite(paths: ProjectPaths) -> None:
    if not paths.optuna_database.is_file():
        with closing(sqlite3.connect(paths.optuna_database)) as made:
            made.execute("pragma journal_mode=wal")


def _prepare_schemas(storage: str) -> None:
    """Make a schema for Optuna and one for MLflow: both own a table `alembic_version`."""
    try:
        import psycopg
    except ImportError:
        raise InputError(
            "a PostgreSQL storage needs psycopg; type: pip install 'pelsvae-studies[postgres]'"
        ) from None
    try:
        with psycopg.connect(storage, autocommit=True, connect_timeout=10) as connection:
            connection.execute("select pg_advisory_lock(7365747570)")
            for schema in ("optuna", "mlflow"):
                connection.execute(f"create schema if not exists {schema}".encode())
    except psycopg.Error as error:
        said = next(iter(hide_passwords(str(error)).splitlines()), type(error).__name__)
        kind = MachineError if "refused" in said or "timeout" in said else InputError
        raise kind(
            f"the storage {hide_passwords(storage)} cannot be used ({said}); correct it or start it"
        ) from None


@contextmanager
def study_locked(storage: RDBStorage, paths: ProjectPaths, name: str) -> Iterator[Callable[[], None]]:
    """Let one worker of a study at a time begin a trial, so that no study gets a trial too many.

    Yields:
        a function that gives the lock back early.
    """
    if paths.storage is None:
        lock = FileLock(paths.mlruns / ".optuna.lock")
        lock.acquire()
        try:
            yield lock.release
        finally:
            lock.release()
        return
    from sqlalchemy import text

    number = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], signed=True)
    with storage.engine.connect() as connection:  # closing it gives the lock back
        connection.execute(text("select pg_advisory_lock(:n)"), {"n": number})

        def release() -> None:
            if not connection.closed:
                connection.execute(text("select pg_advisory_unlock_all()"))
                connection.close()

        try:
            yield release
        finally:
            release()


def make_study(storage: RDBStorage, spec: Declaration, *, n_trials: int) -> optuna.Study:
    """Make the study of a declaration, or find it; its first configurations wait in it."""
    study = optuna.create_study(
        storage=storage, study_name=spec.name, direction="minimize", load_if_exists=True
    )
    if study.user_attrs.get(DECLARATION) != spec.to_dict():
        study.set_user_attr(DECLARATION, spec.to_dict())
    if study.user_attrs.get(PLANNED, 0) < n_trials:
        study.set_user_attr(PLANNED, n_trials)
    for place, params in enumerate(spec.first_points):
        if not study.get_trials(deepcopy=False) or place:
            origin = "default" if place == 0 else "profile"
            study.enqueue_trial(params, user_attrs={PROPOSED_BY: origin}, skip_if_exists=bool(params))
    return study


def claim_next(storage: RDBStorage, study: optuna.Study) -> int:
    """Note on the next trial who works on it while it still waits; call it while the study is locked.

    A worker that is killed while its trial begins so leaves no running trial without an owner. Optuna's own
    heartbeat begins with the objective, so the first one is recorded here.

    Returns:
        The trial's place in the study.
    """
    trials = study.get_trials(deepcopy=False)
    waiting = next((trial for trial in trials if trial.state == TrialState.WAITING), None)
    if waiting is not None:
        set_owner(storage, study, waiting.number)
        return place_of(waiting, trials)
    study.add_trial(optuna.create_trial(state=TrialState.WAITING, user_attrs={OWNER: _owner(len(trials))}))
    storage.record_heartbeat(_trial_id(storage, study, len(trials)))
    return n_begun(trials)


def set_owner(storage: RDBStorage, study: optuna.Study, number: int) -> None:
    """Note that this process works on a trial, and that it lives."""
    trial_id = _trial_id(storage, study, number)
    storage.set_trial_user_attr(trial_id, OWNER, _owner(number))
    storage.record_heartbeat(trial_id)


def _owner(number: int) -> dict[str, Any]:
    return {"trial": number, **this_process()}


def _trial_id(storage: RDBStorage, study: optuna.Study, number: int) -> int:
    study_id = storage.get_study_id_from_name(study.study_name)
    return storage.get_trial_id_from_study_id_trial_number(study_id, number)


def is_owned(trial: FrozenTrial) -> bool:
    """Say whether a worker of this program began the trial; a retry has inherited another one's owner."""
    owner = trial.user_attrs.get(OWNER)
    return isinstance(owner, dict) and owner.get("trial") == trial.number


def declaration_of(study: optuna.Study) -> Declaration:
    """Return what a study was declared with.

    Raises:
        InputError: it was made by another program or version.
    """
    declared = study.user_attrs.get(DECLARATION)
    if not isinstance(declared, dict):
        raise InputError(f"the Optuna study {study.study_name!r} was not made by this program")
    return Declaration.from_dict(declared)


def retried(trial: FrozenTrial) -> int | None:
    """Return the number of the trial that a trial repeats, None where it is no retry."""
    return RetryHeartbeatStaleTrialCallback.retried_trial_number(trial)


def place_of(trial: FrozenTrial, trials: Sequence[FrozenTrial]) -> int:
    """Return a trial's place in its study; a retry has the place of the trial it repeats."""
    first = retried(trial)
    number = trial.number if first is None else first
    return sum(retried(other) is None for other in trials if other.number < number)


def places(trials: Sequence[FrozenTrial]) -> list[FrozenTrial]:
    """Return the latest attempt at each place of a study, in order."""
    latest: dict[int, FrozenTrial] = {}
    for trial in trials:
        first = retried(trial)
        latest[trial.number if first is None else first] = trial
    return [latest[number] for number in sorted(latest)]


def is_unfinished(trials: Sequence[FrozenTrial], n_trials: int) -> bool:
    """Say whether there is a trial to begin: one that waits, or fewer places than planned."""
    return any(trial.state == TrialState.WAITING for trial in trials) or n_begun(trials) < n_trials


def n_begun(trials: Sequence[FrozenTrial]) -> int:
    """Return the number of places that a study has."""
    return sum(retried(trial) is None for trial in trials)


def run_again(study: optuna.Study, trial: FrozenTrial) -> None:
    """Let a trial be run again by whoever comes next, `MAX_RETRIES` times at most."""
    trial = copy.deepcopy(trial)  # Optuna adds to its history
    trial.user_attrs.pop(RUN_ID, None)  # the retry gets a run of its own
    if SEED not in trial.user_attrs:
        # Stopped while it was proposed: a part of its hyperparameters would change the draws of the others.
        trial.distributions, trial.params = {}, {}
    RetryHeartbeatStaleTrialCallback(max_retry=MAX_RETRIES)(study, trial)


def retry_lost(study: optuna.Study) -> list[int]:
    """Fail the running trials whose worker on this machine has died, and let each be run again.

    Call it while the study is locked. The retry is made before the trial is failed: a kill between the two
    leaves a trial that is found again, not one that is lost.

    Returns:
        The numbers of these trials.
    """
    trials = study.get_trials(deepcopy=False)
    repeated = {n for trial in trials for n in RetryHeartbeatStaleTrialCallback.retry_history(trial)}
    lost = [
        trial
        for trial in trials
        if trial.state == TrialState.RUNNING and is_owned(trial) and is_dead(trial.user_attrs[OWNER])
    ]
    for trial in lost:
        if trial.number not in repeated:
            run_again(study, trial)
        study.tell(trial.number, state=TrialState.FAIL, skip_if_finished=True)
    return [trial.number for trial in lost]


def errors_of(trial: FrozenTrial) -> dict[str, float]:
    """Return a trial's errors by name, as `val/mae` and `test/p90`."""
    found = {name: float(v) for name, v in trial.user_attrs.items() if name.startswith(("val/", "test/"))}
    return found if trial.value is None else {"val/mae": float(trial.value), **found}
