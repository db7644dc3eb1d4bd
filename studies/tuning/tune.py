"""Tune the surrogates of several training-set sizes side by side, in worker processes."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import IO, Any

import optuna
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial

from simulation.errors import InputError
from studies.leaderboard import leaderboard_note
from studies.paths import ProjectPaths
from studies.storage_url import STORAGE_VARIABLE
from studies.tracking.runs import RunStore
from studies.tracking.study_run import close_study, end_left_runs, open_study_run
from studies.tuning.declaration import Declaration
from studies.tuning.results import TunedStudy, latest_studies, read_studies, read_study
from studies.tuning.storage import (
    CLOSED,
    is_unfinished,
    make_study,
    retry_lost,
    storage_of,
    study_locked,
)
from studies.tuning.worker import RECIPE, STUDY_RUN

POLL_S = 0.5
MAX_DEATHS = 3
"""Deaths of a worker in a row that brought no trial to its end."""
THREADS = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")


class TuningError(RuntimeError):
    """A worker failed for a reason that is not a trial's."""


@dataclass(frozen=True)
class _Part:
    """A study on its way, and its run in MLflow."""

    spec: Declaration
    study: optuna.Study
    run_id: str
    n_planned: int

    @property
    def trials(self) -> list[FrozenTrial]:
        return self.study.get_trials(deepcopy=False)

    @property
    def is_unfinished(self) -> bool:
        return is_unfinished(self.trials, self.n_planned)


@dataclass
class _Size:
    """The studies of one training-set size, which share workers: a worker's start costs seconds."""

    parts: list[_Part]
    workers: dict["subprocess.Popen[bytes]", IO[bytes]] = field(default_factory=dict)
    n_deaths: int = 0
    n_ended: int = 0
    results: dict[str, TunedStudy] = field(default_factory=dict)

    @property
    def is_unfinished(self) -> bool:
        return any(part.is_unfinished for part in self.parts)


OnTrials = Callable[[Declaration, Sequence[FrozenTrial]], None]


def tune(
    specs: Sequence[Declaration],
    *,
    paths: ProjectPaths,
    n_trials: int,
    n_jobs: int,
    n_parallel: int = 1,
    until_s: float | None = None,
    recipes: Sequence[dict[str, Any]] = (),
    on_trials: OnTrials = lambda spec, trials: None,
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
        recipes: what makes each study's data sets again, kept with every trial.
        on_trials: called with the trials of a study that is worked on, about twice a second.

    Returns:
        The studies as they stand, in the order given.

    Raises:
        InputError: a study cannot be run as declared, or the storage cannot be used.
        TuningError: a worker failed for a reason that is not a trial's.
        KeyboardInterrupt: after the workers were stopped and their trials given back.
    """
    with storage_of(paths) as storage:
        runs = RunStore(paths)
        sizes: dict[int, _Size] = {}
        for spec, recipe in zip(specs, recipes or [{}] * len(specs), strict=True):
            planned = 1 if spec.is_baseline else n_trials
            with study_locked(storage, paths, spec.name):
                study = make_study(storage, spec, n_trials=planned)
            if recipe and study.user_attrs.get(RECIPE) != recipe:
                study.set_user_attr(RECIPE, recipe)
            run_id = open_study_run(runs, spec, planned, study.user_attrs.get(STUDY_RUN), paths)
            if study.user_attrs.get(STUDY_RUN) != run_id:
                study.set_user_attr(STUDY_RUN, run_id)
            part = _Part(spec, study, run_id, planned)
            _give_back(part, storage, paths, runs)
            sizes.setdefault(spec.n_train, _Size([])).parts.append(part)
        largest_first = [sizes[n] for n in sorted(sizes, reverse=True)]
        with _stopped_at_the_end(largest_first, storage, paths, runs):
            while True:
                for size in largest_first:
                    _look_after(size, storage, paths, runs)
                is_late = until_s is not None and time.time() >= until_s
                waiting = [] if is_late else [size for size in largest_first if size.is_unfinished]
                for size in waiting:
                    n_free = n_jobs - sum(len(one.workers) for one in largest_first)
                    for _ in range(min(n_free, n_parallel - len(size.workers))):
                        _start_worker(size, paths, until_s)
                busy = [size for size in largest_first if size.workers]
                for part in (part for size in busy for part in size.parts):
                    on_trials(part.spec, part.trials)
                for size in largest_first:
                    if not size.workers and size not in waiting and not size.results:
                        size.results = {part.spec.name: _close(part, runs, paths) for part in size.parts}
                if not busy and not waiting:
                    break
                time.sleep(POLL_S)
        results = {name: one for size in largest_first for name, one in size.results.items()}
        found = [results[spec.name] for spec in specs]
        # The page shows all sizes of the label, those of other commands too.
        label, case = specs[0].label, specs[0].digests["case"]
        latest = latest_studies(read_studies(paths, label=label), case)
        sizes_now = [one.summary(latest.values()) for key, one in sorted(latest.items()) if not key[1]]
        runs.describe(label, leaderboard_note(sizes_now, specs[0].note))
        return found


def _start_worker(size: _Size, paths: ProjectPaths, until_s: float | None) -> None:
    names = [part.spec.name for part in size.parts]
    command = [sys.executable, "-P", "-m", "studies.tuning.worker", *names, "--child"]
    command += [] if until_s is None else ["--until", repr(until_s)]
    environment = os.environ | THREADS
    if paths.storage is not None:  # not among the arguments, which every user of a machine can read
        environment[STORAGE_VARIABLE] = paths.storage
    messages = tempfile.TemporaryFile()  # noqa: SIM115 (closed with its worker)
    worker = subprocess.Popen(
        command, cwd=paths.root, env=environment, stdin=subprocess.PIPE, stdout=messages, stderr=messages
    )
    size.workers[worker] = messages


def _look_after(size: _Size, storage: RDBStorage, paths: ProjectPaths, runs: RunStore) -> None:
    """See which workers have ended, and why.

    Raises:
        InputError: a worker found the study unusable.
        TuningError: a worker failed, or died again and again before it ended a trial.
    """
    for worker in [one for one in size.workers if one.poll() is not None]:
        with size.workers.pop(worker) as messages, worker:  # which closes its standard input
            messages.seek(0)
            lines = messages.read().decode(errors="replace").strip().splitlines()
        if worker.returncode == 0:
            continue
        for part in size.parts:
            _give_back(part, storage, paths, runs)
        said, name = lines[-1] if lines else "no message", size.parts[0].spec.name
        if worker.returncode == 2:
            raise InputError(said)
        if worker.returncode > 0:
            raise TuningError(f"a worker of {name} failed: {said}")
        n_ended = sum(trial.state.is_finished() for part in size.parts for trial in part.trials)
        size.n_deaths, size.n_ended = size.n_deaths + 1 if n_ended <= size.n_ended else 1, n_ended
        if size.n_deaths > MAX_DEATHS:
            raise TuningError(
                f"a worker of {name} was killed by signal {-worker.returncode} {size.n_deaths} times before "
                f"it ended a trial ({said})"
            )


def _give_back(part: _Part, storage: RDBStorage, paths: ProjectPaths, runs: RunStore) -> None:
    """Let the trials of dead workers be run again, and end the runs that they left open."""
    with study_locked(storage, paths, part.spec.name):
        retry_lost(part.study)
    end_left_runs(runs, part.study, part.spec)


@contextmanager
def _stopped_at_the_end(
    sizes: Sequence[_Size], storage: RDBStorage, paths: ProjectPaths, runs: RunStore
) -> Iterator[None]:
    """Stop the workers where anything goes wrong, and give their trials back."""
    try:
        yield
    except BaseException:
        workers = {worker: messages for size in sizes for worker, messages in size.workers.items()}
        for worker in workers:
            worker.kill()
        for worker, messages in workers.items():
            with messages, worker:  # waits for its end
                pass
        for part in (part for size in sizes for part in size.parts):
            # What cannot be done now, as where the storage is away, the next command does.
            with suppress(Exception):
                _give_back(part, storage, paths, runs)
                runs.end(part.run_id, "KILLED")
        raise


def closed_studies(
    specs: Sequence[Declaration], paths: ProjectPaths, n_trials: int
) -> list[TunedStudy] | None:
    """Return the studies where all of them are finished and registered, None where work is left."""
    known = {one.spec.name: one for one in read_studies(paths, label=specs[0].label)}
    found = [known[spec.name] for spec in specs if spec.name in known]
    are_closed = len(found) == len(specs) and all(
        one.n_closed == one.n_ended == len(one.trials) >= (1 if one.spec.is_baseline else n_trials)
        for one in found
    )
    return found if are_closed else None


def _close(part: _Part, runs: RunStore, paths: ProjectPaths) -> TunedStudy:
    """Register the best surrogate of a study and end its run."""
    found = read_study(part.study)
    close_study(runs, part.spec, found, part.run_id, paths)
    part.study.set_user_attr(CLOSED, len(found.trials))
    return found
