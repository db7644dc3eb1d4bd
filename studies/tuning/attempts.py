"""The trials of a study in Optuna's storage: whose they are, and what follows where their worker died.

A place is a trial and the retries of it: a study of 20 trials has 20 places, however often a worker died.
"""

import copy
import socket
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import optuna
import psutil
from optuna.storages import RDBStorage, RetryHeartbeatStaleTrialCallback
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState

from pelsvae.config import SurrogateConfig
from simulation.errors import InputError
from studies.results.declaration import Declaration, StudyDeclaration
from studies.results.objective import ObjectiveDeclaration
from studies.results.saved import rebuilt

if TYPE_CHECKING:
    from optuna.study._frozen import FrozenStudy

D = TypeVar("D", bound=StudyDeclaration)
MAX_RETRIES = 5
"""Of a trial whose worker dies; a trial that kills its worker again and again fails."""
RUN_ID, OWNER = "mlflow_run_id", "owner"
DECLARATION, PLANNED, PROVENANCE, CLOSED = "declaration", "n_trials", "provenance", "closed"
"""Attributes of a study; `closed` says how many trials had ended when its best surrogate was registered."""
ALLOWED = "allowed"
"""Attribute of a study: trials that may begin before the next smaller size has ended."""
CARRIED = "carried_from"
"""Attribute of a trial that an earlier study trained: which one it is there."""
GONE = "gone"
"""Attribute of a study: runs in MLflow that cannot be recommended, as their owner deleted them."""
VERSIONS = "versions"
"""Attribute of a study: versions of models in MLflow's registry, by run."""
CONFIRMATION = "confirmation"
"""Who proposed a trial that trains the configuration of another one with a further seed."""
MEAN = "mean"
"""Attribute of a study: the best mean of its surrogates."""
PROPOSED_BY, SEED = "proposed_by", "seed"
"""Attribute of a trial whose hyperparameters are all chosen."""
CONSTRAINTS = "constraints"
"""Begins the names under which Optuna keeps them; the first value that a trial sets counts."""
_SAME_START_S = 1.0  # the start of a process is derived from a clock that may be set meanwhile


@contextmanager
def experimental() -> Iterator[None]:
    """Use what Optuna warns may change; the warnings of a script stay as they are."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        yield


def make_study(
    storage: RDBStorage,
    spec: StudyDeclaration,
    *,
    n_trials: int,
    carried: Iterable[FrozenTrial] = (),
    has_smaller: bool = False,
) -> optuna.Study:
    """Make the study of a declaration, or find it; its first configurations wait in it.

    Args:
        storage: Optuna's.
        spec: the study.
        n_trials: trials that it shall have.
        carried: trials of earlier studies that are trials of this one, too; read where it is new.
        has_smaller: whether its last trial waits for the best configuration of a smaller size.
    """
    up, down = StudyDirection.MAXIMIZE, StudyDirection.MINIMIZE
    directions = [up if name in spec.maximize else down for name in spec.value_names]
    study = optuna.create_study(
        storage=storage, study_name=spec.name, directions=directions, load_if_exists=True
    )
    # The declared name has a digest of what decides; a device or a limit may still have changed.
    if study.user_attrs.get(DECLARATION) != spec.to_dict():
        study.set_user_attr(DECLARATION, spec.to_dict())
    # The latest command decides, also with fewer trials than an interrupted one wanted.
    if study.user_attrs.get(PLANNED) != n_trials:
        study.set_user_attr(PLANNED, n_trials)
    with experimental():
        if study.metric_names is None:
            study.set_metric_names([*spec.value_names])  # as in MLflow
    trials = study.get_trials(deepcopy=False)
    is_new = all(CARRIED in one.user_attrs for one in trials)
    taken = {one.user_attrs[RUN_ID] for one in trials} if is_new else set()
    for one in carried if is_new else ():  # a kill leaves some of them
        if one.user_attrs[RUN_ID] not in taken:
            study.add_trial(one)
    for place, params in enumerate(spec.first_points):
        # Without hyperparameters every trial equals this one, and Optuna would skip it.
        if is_new or place:
            origin = "default" if place == 0 and isinstance(spec, Declaration) else "profile"
            study.enqueue_trial(params, user_attrs={PROPOSED_BY: origin}, skip_if_exists=bool(params))
    is_held = has_smaller and n_begun(study.get_trials(deepcopy=False)) < n_trials
    if study.user_attrs.get(ALLOWED, n_trials) != (allowed := n_trials - is_held):
        study.set_user_attr(ALLOWED, allowed)
    return study


def n_allowed(study: optuna.Study) -> int:
    """Return how many trials a study may have by now."""
    attrs = study.user_attrs
    return min(int(attrs.get(PLANNED, 0)), int(attrs.get(ALLOWED, attrs.get(PLANNED, 0))))


def begin_last(study: optuna.Study, spec: Declaration, best: SurrogateConfig | None) -> None:
    """Enqueue the best settings of the next smaller size, and let the last trial begin.

    Call it while the study is locked. What was tried before is not tried again: the sampler proposes then.
    """
    planned = int(study.user_attrs.get(PLANNED, 0))
    point = None if best is None else spec.point_of(best)
    if point and n_begun(study.get_trials(deepcopy=False)) < planned:
        study.enqueue_trial(point, user_attrs={PROPOSED_BY: "smaller size"}, skip_if_exists=True)
    study.set_user_attr(ALLOWED, planned)


def lease_next(storage: RDBStorage, study: optuna.Study) -> int:
    """Note on the next trial who works on it while it still waits; call it while the study is locked.

    A worker that is killed while its trial begins so leaves no running trial without an owner. Optuna's own
    heartbeat begins with the objective, so the first one is recorded here.

    Returns:
        The trial's place in the study.
    """
    trials = study.get_trials(deepcopy=False)
    # Optuna, too, takes the waiting trial of the lowest number.
    waiting = next((trial for trial in trials if trial.state == TrialState.WAITING), None)
    if waiting is not None:
        set_owner(storage, study, waiting.number)
        return place_of(waiting, trials)
    # Its number is known beforehand, as no other worker of ours adds one meanwhile.
    study.add_trial(optuna.create_trial(state=TrialState.WAITING, user_attrs={OWNER: _owner(len(trials))}))
    storage.record_heartbeat(_trial_id(storage, study, len(trials)))
    return n_begun(trials)


def set_owner(storage: RDBStorage, study: optuna.Study, number: int) -> None:
    """Note that this process works on a trial, and that it lives."""
    trial_id = _trial_id(storage, study, number)
    storage.set_trial_user_attr(trial_id, OWNER, _owner(number))
    storage.record_heartbeat(trial_id)


def _owner(number: int) -> dict[str, Any]:
    me = psutil.Process()
    return {"trial": number, "machine": this_machine(), "pid": me.pid, "started_s": me.create_time()}


def _trial_id(storage: RDBStorage, study: optuna.Study, number: int) -> int:
    study_id = storage.get_study_id_from_name(study.study_name)
    return storage.get_trial_id_from_study_id_trial_number(study_id, number)


def is_owned(trial: FrozenTrial) -> bool:
    """Say whether a worker of this program began the trial; a retry has inherited another one's owner."""
    owner = trial.user_attrs.get(OWNER)
    return isinstance(owner, dict) and owner.get("trial") == trial.number


def declaration_of(study: "optuna.Study | FrozenStudy", kind: type[D] = Declaration) -> D:
    """Return what a study was declared with.

    Args:
        study: the study.
        kind: what its trials do.

    Raises:
        InputError: it was made by another program or version, or its trials do something else.
    """
    declared = study.user_attrs.get(DECLARATION)
    if not isinstance(declared, dict):
        raise InputError(f"the Optuna study {study.study_name!r} was not made by this program")
    if is_of_objective(declared) != (kind is ObjectiveDeclaration):
        raise InputError(
            f"the trials of {study.study_name!r} are not of this kind; those of a function need "
            f"studies tune --objective MODULE:FUNCTION --name {declared.get('label')}"
        )
    return rebuilt(kind, declared, f"the Optuna study {study.study_name!r}")


def is_of_objective(declared: Any) -> bool:
    """Say whether a declaration is of a user's objective, and not of a surrogate."""
    return isinstance(declared, dict) and "values" in declared


def first_number(trial: FrozenTrial) -> int:
    """Return the number of the first attempt at a trial's place: another one's where it is a retry."""
    with experimental():
        first = RetryHeartbeatStaleTrialCallback.retried_trial_number(trial)
    return trial.number if first is None else first


def enqueued(trial: FrozenTrial) -> dict[str, Any]:
    """Return the hyperparameters that a trial was enqueued with, under the name that Optuna gives them."""
    return dict(trial.system_attrs.get("fixed_params", {}))


def place_of(trial: FrozenTrial, trials: Sequence[FrozenTrial]) -> int:
    """Return a trial's place in its study; a retry has the place of the trial it repeats."""
    return n_begun(trials[: first_number(trial)])


def places(trials: Sequence[FrozenTrial]) -> list[FrozenTrial]:
    """Return the latest attempt at each place of a study, in order."""
    # A later attempt takes the earlier one's position: a dict leaves a key where it first was.
    return list({first_number(trial): trial for trial in trials}.values())


def is_unfinished(trials: Sequence[FrozenTrial], n_trials: int) -> bool:
    """Say whether there is a trial to begin: one that waits, or fewer places than planned."""
    return any(trial.state == TrialState.WAITING for trial in trials) or n_begun(trials) < n_trials


def n_begun(trials: Sequence[FrozenTrial]) -> int:
    """Return the number of places that a study has."""
    return sum(first_number(trial) == trial.number for trial in trials)


def run_again(study: optuna.Study, trial: FrozenTrial) -> None:
    """Let a trial be run again by whoever comes next, `MAX_RETRIES` times at most."""
    trial = copy.deepcopy(trial)  # Optuna adds to its history
    trial.user_attrs.pop(RUN_ID, None)  # the retry gets a run of its own
    if SEED not in trial.user_attrs:
        # Stopped while it was proposed: a part of its hyperparameters would change the draws of the others.
        trial.distributions, trial.params = {}, {}
        for name in [one for one in trial.system_attrs if one.startswith(CONSTRAINTS)]:
            del trial.system_attrs[name]
    # Optuna's own callback: what other programs read of retries then holds here too.
    with experimental():
        RetryHeartbeatStaleTrialCallback(max_retry=MAX_RETRIES)(study, trial)


def retry_lost(study: optuna.Study) -> None:
    """Fail the running trials whose worker on this machine has died, and let each be run again.

    Call it while the study is locked. The retry is made before the trial is failed: a kill between the two
    leaves a trial that is found again, not one that is lost.
    """
    trials = study.get_trials(deepcopy=False)
    with experimental():
        repeated = {n for trial in trials for n in RetryHeartbeatStaleTrialCallback.retry_history(trial)}
    ours = [trial for trial in trials if trial.state == TrialState.RUNNING and is_owned(trial)]
    for trial in (one for one in ours if is_dead(one.user_attrs[OWNER])):
        # A kill between retry and failure: the retry is there already.
        if trial.number not in repeated:
            run_again(study, trial)
        study.tell(trial.number, state=TrialState.FAIL, skip_if_finished=True)


@cache
def this_machine() -> str:
    """Name the set of processes that this one can see: a boot of a machine, or a container on it."""
    return f"{socket.gethostname()}/{Path('/proc/self/ns/pid').readlink()}"


def is_dead(owner: Mapping[str, Any]) -> bool:
    """Say whether a process of this machine has ended; of other machines Optuna's heartbeat decides."""
    if owner.get("machine") != this_machine():
        return False
    try:
        process = psutil.Process(int(owner["pid"]))
        # The system gives numbers of dead processes to new ones, which started at another time.
        is_same = abs(process.create_time() - float(owner["started_s"])) < _SAME_START_S
        # A zombie has ended and waits for its parent alone.
        return not is_same or bool(process.status() == psutil.STATUS_ZOMBIE)
    except (psutil.Error, KeyError, ValueError, TypeError):
        return True
