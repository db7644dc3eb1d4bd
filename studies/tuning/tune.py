"""Tune the surrogates of several training-set sizes at once: one Optuna study each, in worker processes."""

import logging
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeVar

from simulation.errors import InputError
from simulation.workers.parallel import available_cores
from studies.paths import ProjectPaths
from studies.tracking.tracker import NullTracker, Tracker
from studies.tuning.champion import crown
from studies.tuning.crew import Crew
from studies.tuning.outage import wait_out
from studies.tuning.postgres import database
from studies.tuning.study_spec import StudySpec, StudySummary, TuneEvent
from studies.tuning.study_store import StudyStore
from studies.tuning.trial_record import TrialRecord, best_record, summarize
from studies.tuning.trial_store import StudyEntry, TrialStore, open_trials

_T = TypeVar("_T")
logger = logging.getLogger(__name__)


def tune(
    studies: Sequence[StudySpec],
    *,
    paths: ProjectPaths,
    n_trials: int,
    n_jobs: int | None = None,
    max_s: float | None = None,
    tracker: Tracker | None = None,
    on_event: Callable[[TuneEvent], None] | None = None,
) -> list[StudySummary]:
    """Bring every study to `n_trials` finished trials and crown its best surrogate.

    Studies run side by side, the largest training set first, and of each study so many trials as its
    `n_parallel` says; other commands, also on other machines with the same storage, may work on them too.
    What the trials are depends neither on `n_jobs` nor on who trains them, on interruptions or on how often a
    study was extended.

    Args:
        studies: the studies.
        paths: the project.
        n_trials: finished trials per study in total, those of earlier calls and of other commands included.
        n_jobs: worker processes; None means one per core that this process may use.
        max_s: no trial begins after this time; those that run are trained to their end. [s]
        tracker: is told of studies, trials and champions, always from this process.
        on_event: told of trials and epochs, a few times a second at most.

    Returns:
        One summary per study, in the order given.

    Raises:
        InputError: a study cannot be run as declared, or the storage cannot be used.
        studies.tuning.crew.TuningError: a worker failed for a reason that is not a trial's.
        KeyboardInterrupt: after the workers have stopped and their trials have been given back.
    """
    deadline_s = None if max_s is None else time.time() + max_s
    desk = _Desk(paths, n_trials, tracker or NullTracker(), on_event or (lambda event: None))
    for spec in studies:
        desk.welcome(spec)
    # A study that starts from another's best comes after it.
    unfinished = sorted(
        (spec for spec in studies if not desk.is_finished(spec)),
        key=lambda spec: spec.n_train if spec.warm_start else -spec.n_train,
    )
    crew = Crew(
        paths=paths,
        n_trials=n_trials,
        n_workers=n_jobs or available_cores(),
        deadline_s=deadline_s,
        tell=desk.tell,
    )
    try:
        for spec in studies:
            desk.open(spec)
        for spec, event in crew.run(unfinished):
            desk.hear(spec, event)
    except BaseException:
        crew.dismiss()
        for spec in unfinished:
            with suppress(InputError, OSError):  # stores that are away are told by the next command
                desk.abandon(spec)
        raise
    else:
        return [desk.close(spec) for spec in studies]
    finally:
        desk.leave()


class _Desk:
    """Keeps Optuna, the tracker and the champions in step with the records."""

    def __init__(
        self, paths: ProjectPaths, n_trials: int, tracker: Tracker, on_event: Callable[[TuneEvent], None]
    ) -> None:
        self._paths = paths
        self._n_trials = n_trials
        self._tracker = tracker
        self._on_event = on_event
        self._trials: dict[str, TrialStore] = {}
        self._optuna: dict[str, StudyStore] = {}
        self._summaries: dict[str, StudySummary] = {}
        self._away_since_s: float | None = None

    def welcome(self, spec: StudySpec) -> None:
        """Note that a study is asked for; the first word to its stores says whether they can be used."""
        store = self._trials[spec.name] = open_trials(self._paths, spec)
        store.describe(StudyEntry.of(spec, n_planned=self._n_trials, created_s=time.time()))
        self._optuna[spec.name] = StudyStore(spec, self._paths)

    def is_finished(self, spec: StudySpec) -> bool:
        return len(set(self._trials[spec.name].finished()) & set(range(self._n_trials))) == self._n_trials

    def open(self, spec: StudySpec) -> None:
        self._patiently(lambda: self._optuna[spec.name].tell(self._trials[spec.name]))
        self._reach()
        self._tracker.start_study(spec, n_trials=self._n_trials)
        for record in self._trials[spec.name].records():
            self._track_trial(spec, record)

    def hear(self, spec: StudySpec, event: TuneEvent) -> None:
        if event.kind == "waiting":
            if self._paths.storage is None:
                self.tell(event.message)
            self._reach()
            return
        if event.kind == "joined":
            logger.warning("%s", event.message)
            return
        if event.kind == "trial-finished":
            self._patiently(lambda: self._optuna[spec.name].tell(self._trials[spec.name]))
            record = self._patiently(lambda: self._trials[spec.name].record(event.index))
            if record is not None:
                self._reach()
                self._track_trial(spec, record)
        elif event.kind == "study-finished":
            self.close(spec)
        self._on_event(event)

    def close(self, spec: StudySpec) -> StudySummary:
        """Crown the best surrogate of a study, once, and close its run."""
        if spec.name in self._summaries:
            return self._summaries[spec.name]
        # Nobody has told of trials that failed with their process, nor of those of other commands.
        self._patiently(lambda: self._optuna[spec.name].tell(self._trials[spec.name]))
        records = self._patiently(self._trials[spec.name].records)
        self._reach()
        for record in records:
            self._track_trial(spec, record)
        best = best_record(records)
        champion = None
        if best is not None:
            champion = self._paths.champion(spec.label, spec.n_train)
            self._crown(spec, best)
            self._tracker.register_champion(spec, champion)
        summary = summarize(spec, records, champion)
        self._tracker.finish_study(spec, summary, "FINISHED")
        self._summaries[spec.name] = summary
        return summary

    def abandon(self, spec: StudySpec) -> None:
        """Tell of what is finished, without waiting for a store that is away, and close the study's run."""
        if spec.name in self._summaries:
            return
        self._optuna[spec.name].tell(self._trials[spec.name])
        records = self._trials[spec.name].records()
        self._tracker.finish_study(spec, summarize(spec, records, None), "KILLED")

    def leave(self) -> None:
        """Hang up."""
        for study in self._optuna.values():
            study.close()

    def tell(self, line: str) -> None:
        """Say in one line what is waited for, and in another that it is there again."""
        if line and self._away_since_s is None:
            self._away_since_s = time.monotonic()
            logger.warning("waiting: %s", line)
        elif not line and self._away_since_s is not None:
            away_s, self._away_since_s = time.monotonic() - self._away_since_s, None
            logger.warning("going on after %.0f s of waiting; nothing is lost", away_s)

    def _crown(self, spec: StudySpec, best: TrialRecord) -> None:
        run_id = self._tracker.trial_run_id(spec, best.key)
        if self._patiently(lambda: crown(self._paths, spec, best, run_id)):
            return
        # Another command may have found a better one by now and keeps the weights of that one alone.
        newest = best_record(self._patiently(self._trials[spec.name].records))
        if newest is None or newest.index == best.index:
            raise InputError(f"the weights of {best.key} are gone; type: studies doctor --repair")
        self._crown(spec, newest)

    def _track_trial(self, spec: StudySpec, record: TrialRecord) -> None:
        store = self._trials[spec.name]
        self._tracker.log_trial(spec, record, lambda: store.history(record.index))

    def _reach(self) -> None:
        """Wait until the server answers, before the tracker asks it: it would not wait."""
        if self._paths.storage is not None:
            server = database(self._paths.storage)
            self._patiently(lambda: server.rows("select 1"))

    def _patiently(self, work: Callable[[], _T]) -> _T:
        return wait_out(work, tell=self.tell)
