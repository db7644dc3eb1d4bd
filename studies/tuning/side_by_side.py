"""Studies on their way, side by side: their worker processes, and what follows where one of them ends."""

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Generic, TypeVar

import optuna
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.results.declaration import StudyDeclaration
from studies.task import StageError
from studies.tracking.runs import RunStore
from studies.tracking.study_run import end_left_runs, open_study_run
from studies.tuning import attempts
from studies.tuning.forked_worker import ForkedWorker
from studies.tuning.storage import study_locked

POLL_S = 0.5
MAX_DEATHS = 3
"""Deaths of a worker in a row that brought no trial to its end."""


@dataclass(frozen=True)
class Part:
    """A study on its way, and its run in MLflow."""

    spec: StudyDeclaration
    study: optuna.Study
    run_id: str
    storage: RDBStorage
    paths: ProjectPaths
    runs: RunStore

    @property
    def trials(self) -> list[FrozenTrial]:
        """Its trials, retries included."""
        return self.study.get_trials(deepcopy=False)

    @property
    def is_unfinished(self) -> bool:
        """Whether a worker would find a trial to begin; how many are planned the latest command decides."""
        return attempts.is_unfinished(self.trials, attempts.n_allowed(self.study))

    @property
    def is_held(self) -> bool:
        """Whether its last trial waits for another study."""
        return attempts.n_allowed(self.study) < int(self.study.user_attrs.get(attempts.PLANNED, 0))

    def give_back(self) -> None:
        """Let the trials of dead workers be run again, and end the runs that they left open."""
        with study_locked(self.storage, self.paths, self.spec.name):
            attempts.retry_lost(self.study)
        end_left_runs(self.runs, self.study, self.spec)


def opened_run(
    study: optuna.Study,
    runs: RunStore,
    spec: StudyDeclaration,
    n_trials: int,
    provenance: Mapping[str, Any] | None,
) -> str:
    """Open the run of a study, note on the study which one it is and what makes it again; return its id."""
    run_id = open_study_run(runs, spec, n_trials, study.user_attrs.get(attempts.RUN_ID))
    for name, value in {attempts.PROVENANCE: provenance, attempts.RUN_ID: run_id}.items():
        if value and study.user_attrs.get(name) != value:
            study.set_user_attr(name, value)
    return run_id


P = TypeVar("P", bound=Part)


@dataclass
class Group(Generic[P]):
    """Studies that share workers: a worker's start costs seconds."""

    parts: list[P]
    workers: list[ForkedWorker] = field(default_factory=list)
    n_deaths: int = 0
    n_ended: int = 0
    is_closed: bool = False

    @property
    def is_held(self) -> bool:
        """Whether a last trial waits for another study."""
        return any(part.is_held for part in self.parts)

    def is_waiting(self, n_parallel: int) -> bool:
        """Whether one of at most `n_parallel` workers could begin a trial."""
        is_full = len(self.workers) >= n_parallel
        return not is_full and any(part.is_unfinished for part in self.parts)

    def look_after_workers(self) -> None:
        """See which workers have ended, and why.

        Raises:
            InputError: a worker found the study unusable.
            StageError: a worker failed, or died again and again before it ended a trial.
        """
        for worker in [one for one in self.workers if one.process.exitcode is not None]:
            self.workers.remove(worker)
            code, said = worker.process.exitcode, worker.last_line()
            assert code is not None, "it has ended"
            if code == 0:
                continue
            # Before anything is raised: the trial of the dead worker waits again whatever follows.
            for part in self.parts:
                part.give_back()
            name = self.parts[0].spec.name
            # As every command: bad input ends with 2, a fault of the machine with 1, a signal below 0.
            if code == 2:
                raise InputError(said)
            if code > 0:
                raise StageError(f"tune: a worker of {name} failed: {said}")
            n_ended = sum(trial.state.is_finished() for part in self.parts for trial in part.trials)
            self.n_deaths = self.n_deaths + 1 if n_ended <= self.n_ended else 1
            self.n_ended = n_ended
            if self.n_deaths > MAX_DEATHS:
                raise StageError(
                    f"tune: a worker of {name} was killed by signal {-code} "
                    f"{self.n_deaths} times before it ended a trial ({said})"
                )

    def stop(self) -> None:
        """Stop the workers and give their trials back."""
        for worker in self.workers:
            # All are killed before the first is waited for.
            worker.process.kill()
        for worker in self.workers:
            worker.join()
        # What cannot be done now, as where the storage is away, the next command does.
        with suppress(Exception):
            for part in self.parts:
                part.give_back()
                part.runs.end(part.run_id, "KILLED")


G = TypeVar("G", bound=Group[Any])


def work_on(
    groups: Sequence[G],
    *,
    n_jobs: int,
    n_parallel: int,
    until_s: float | None,
    on_poll: Callable[[G], None],
    on_over: Callable[[G], None],
    on_free: Callable[[G], None] = lambda group: None,
    objective: bytes | None = None,
) -> None:
    """Bring studies to their trials, those of the first group first.

    Args:
        groups: the studies.
        n_jobs: worker processes.
        n_parallel: workers of one group.
        until_s: no trial begins after this moment of `time.monotonic`. [s]
        on_poll: called with a group that is worked on, about twice a second.
        on_over: called with a group whose trials have ended, once.
        on_free: called with a group where a worker may begin.
        objective: what the trials do, see `ForkedWorker`.

    Raises:
        InputError: a study cannot be run as declared.
        StageError: a worker failed for a reason that is not a trial's.
        KeyboardInterrupt: after the workers were stopped and their trials given back.
    """
    n_threads = max(n_jobs // (n_parallel * len(groups)), 1)
    try:
        while True:
            for group in groups:
                group.look_after_workers()
            is_late = until_s is not None and time.monotonic() >= until_s
            n_free = n_jobs - sum(len(one.workers) for one in groups)
            # Trials are read where a worker may begin: to read them takes time from those that work.
            may_begin = bool(n_free) and not is_late
            for group in groups if may_begin else []:
                on_free(group)
            waiting = [group for group in groups if may_begin and group.is_waiting(n_parallel)]
            for group in waiting:
                names = [part.spec.name for part in group.parts if part.is_unfinished]
                for _ in range(min(n_free, n_parallel - len(group.workers))):
                    paths = group.parts[0].paths
                    group.workers.append(ForkedWorker(paths, names, until_s, n_threads, objective))
                    n_free -= 1
            busy = [group for group in groups if group.workers]
            for group in busy:
                on_poll(group)
            for group in groups if may_begin or is_late else []:
                is_over = not (group.workers or group in waiting or (group.is_held and not is_late))
                if is_over and not group.is_closed:
                    on_over(group)
                    group.is_closed = True
            if not busy and not waiting:
                return
            time.sleep(POLL_S)
    # Ctrl-C as well: no worker outlives the command.
    except BaseException:
        for group in groups:
            group.stop()
        raise
