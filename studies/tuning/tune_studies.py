"""Tune the surrogates of several training-set sizes side by side, in worker processes."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import optuna
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.results.declaration import Declaration
from studies.results.trials import TunedStudy
from studies.task import StageError
from studies.tracking.runs import RunStore
from studies.tracking.sending import begin_sending
from studies.tracking.study_run import close_study, end_left_runs, open_study_run, without_deleted
from studies.tuning import attempts
from studies.tuning.forked_worker import ForkedWorker
from studies.tuning.storage import storage_of, study_locked
from studies.tuning.study_results import latest_studies, read_studies, read_study
from studies.words.wording import setting, significant

POLL_S = 0.5
MAX_DEATHS = 3
"""Deaths of a worker in a row that brought no trial to its end."""


@dataclass(frozen=True)
class _Part:
    """A study on its way, and its run in MLflow."""

    spec: Declaration
    study: optuna.Study
    run_id: str
    storage: RDBStorage
    paths: ProjectPaths
    runs: RunStore

    @property
    def trials(self) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False)

    @property
    def is_unfinished(self) -> bool:
        """Whether a worker would find a trial to begin; how many are planned the latest command decides."""
        return attempts.is_unfinished(self.trials, int(self.study.user_attrs.get(attempts.PLANNED, 0)))

    def give_back(self) -> None:
        """Let the trials of dead workers be run again, and end the runs that they left open."""
        with study_locked(self.storage, self.paths, self.spec.name):
            attempts.retry_lost(self.study)
        end_left_runs(self.runs, self.study, self.spec)

    def close(self, on_warning: Callable[[str], None]) -> TunedStudy:
        """Register the best surrogate of a study and end its run."""
        found, fault = without_deleted(self.runs, read_study(self.study))
        if fault:
            on_warning(fault)
        if self.study.user_attrs.get(attempts.GONE, []) != sorted(found.gone):
            self.study.set_user_attr(attempts.GONE, sorted(found.gone))
        close_study(self.runs, self.spec, found, self.run_id)
        self.study.set_user_attr(attempts.CLOSED, len(found.trials))
        return found


@dataclass
class _Size:
    """The studies of one training-set size, which share workers: a worker's start costs seconds."""

    parts: list[_Part]
    workers: list[ForkedWorker] = field(default_factory=list)
    n_deaths: int = 0
    n_ended: int = 0
    results: dict[str, TunedStudy] = field(default_factory=dict)

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


_LOG = logging.getLogger(__name__)
BEST_OF_SIZES = "Best per n_train"
"""Begins our line in the note of an experiment."""
OnTrials = Callable[[Declaration, Sequence[FrozenTrial]], None]


def tune(
    specs: Sequence[Declaration],
    *,
    paths: ProjectPaths,
    n_trials: int,
    n_jobs: int,
    n_parallel: int = 1,
    until_s: float | None = None,
    provenance: Mapping[str, Any] | None = None,
    on_trials: OnTrials = lambda spec, trials: None,
    on_warning: Callable[[str], None] = _LOG.warning,
) -> list[TunedStudy]:
    """Bring every study to `n_trials` trials and register its best surrogate.

    Studies run side by side, the largest training set first. Trials that were enqueued or added through
    Optuna count; those that run in other commands are not waited for. With `n_parallel` 1 the trials depend
    neither on `n_jobs` nor on interruptions; a killed worker's trial is run again.

    Args:
        specs: the studies.
        paths: the project.
        n_trials: trials per study in total; a baseline has one.
        n_jobs: worker processes.
        n_parallel: workers of one study.
        until_s: no trial begins after this moment. [s since 1970, UTC]
        provenance: what makes the data sets again, kept with every trial.
        on_trials: called with the trials of a study that is worked on, about twice a second.
        on_warning: called with one line that a user should see.

    Returns:
        The studies as they stand, in the order given.

    Raises:
        InputError: a study cannot be run as declared, or the storage cannot be used.
        StageError: a worker failed for a reason that is not a trial's.
        KeyboardInterrupt: after the workers were stopped and their trials given back.
    """
    with storage_of(paths) as storage:
        runs = RunStore(paths)
        begin_sending(paths)
        sizes: dict[int, _Size] = {}
        for spec in specs:
            planned = 1 if spec.is_baseline else n_trials
            with study_locked(storage, paths, spec.name):
                study = attempts.make_study(storage, spec, n_trials=planned)
            run_id = open_study_run(runs, spec, planned, study.user_attrs.get(attempts.RUN_ID))
            for name, value in {attempts.PROVENANCE: provenance, attempts.RUN_ID: run_id}.items():
                if value and study.user_attrs.get(name) != value:
                    study.set_user_attr(name, value)
            part = _Part(spec, study, run_id, storage, paths, runs)
            part.give_back()
            sizes.setdefault(spec.n_train, _Size([])).parts.append(part)
        # Begun last, the longest trainings would run alone at the end.
        largest_first = [sizes[n] for n in sorted(sizes, reverse=True)]
        try:
            while True:
                for size in largest_first:
                    size.look_after_workers()
                is_late = until_s is not None and time.time() >= until_s
                n_free = n_jobs - sum(len(one.workers) for one in largest_first)
                # Trials are read where a worker may begin: to read them takes time from those that train.
                may_begin = bool(n_free) and not is_late
                waiting = [size for size in largest_first if may_begin and size.is_waiting(n_parallel)]
                for size in waiting:
                    names = [part.spec.name for part in size.parts]
                    for _ in range(min(n_free, n_parallel - len(size.workers))):
                        size.workers.append(ForkedWorker(paths, names, until_s))
                        n_free -= 1
                busy = [size for size in largest_first if size.workers]
                for part in (part for size in busy for part in size.parts):
                    on_trials(part.spec, part.trials)
                for size in largest_first if may_begin or is_late else []:
                    if not size.workers and size not in waiting and not size.results:
                        size.results = {part.spec.name: part.close(on_warning) for part in size.parts}
                if not busy and not waiting:
                    break
                time.sleep(POLL_S)
        # Ctrl-C as well: no worker outlives the command.
        except BaseException:
            for size in largest_first:
                size.stop()
            raise
        runs.describe(specs[0].label, BEST_OF_SIZES, _best_of_sizes(paths, specs[0]), specs[0].note)
        return [sizes[spec.n_train].results[spec.name] for spec in specs]


def _best_of_sizes(paths: ProjectPaths, spec: Declaration) -> str:
    """Name the best model of each size in one line: MLflow's page shows one until its note is unfolded.

    All sizes of the label are named, those of other commands too.
    """
    latest = latest_studies(read_studies(paths, label=spec.label), spec.digests["case"])
    sizes = [one.summary() for (_, is_baseline), one in sorted(latest.items()) if not is_baseline]
    found = [one for one in sizes if one.trial is not None]
    if not found:
        return ""
    names = list(dict.fromkeys(name for one in found for name in one.params))
    each = [
        f"{one.n_train}: {' / '.join(setting(one.params.get(name)) for name in names)} → "
        f"{', '.join(significant(one.metrics[name]) for name in ('test/mae', 'test/p90'))}"
        for one in found
    ]
    return f" ({' / '.join(names)} → test MAE, P90 {found[0].unit}): {' · '.join(each)}"


def closed_studies(
    specs: Sequence[Declaration], paths: ProjectPaths, n_trials: int
) -> list[TunedStudy] | None:
    """Return the studies where all of them are finished and registered, None where work is left."""
    known = {one.spec.name: one for one in read_studies(paths, label=specs[0].label)}
    found = [known[spec.name] for spec in specs if spec.name in known]
    are_ended = all(one.n_closed == one.n_ended == len(one.trials) for one in found)
    are_enough = all(one.n_ended >= (1 if one.spec.is_baseline else n_trials) for one in found)
    return found if len(found) == len(specs) and are_ended and are_enough else None
