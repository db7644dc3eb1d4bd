"""A worker: takes one trial after the other from several studies, whichever has one to give."""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

from pelsvae.epochs import EpochReport
from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.tuning.claim import Claim, this_owner
from studies.tuning.known_good import Neighbour
from studies.tuning.outage import StudyInterruptedError, wait_out
from studies.tuning.slots import Answer, Slot, release, take_slot
from studies.tuning.study_data import StudyData, load_data
from studies.tuning.study_spec import EventKind, StudySpec, TuneEvent
from studies.tuning.trial_attempt import attempt
from studies.tuning.trial_record import TrialRecord, best_record
from studies.tuning.trial_store import list_studies, open_trials

EVENT_PERIOD_S = 0.25
FIRST_POLL_S = 0.05
LONGEST_POLL_S = 1.0
N_DATA_SETS = 2  # of so many studies a worker keeps the data in memory

_T = TypeVar("_T")


def run_study(
    spec: StudySpec,
    *,
    paths: ProjectPaths,
    n_trials: int,
    emit: Callable[[TuneEvent], None],
    should_stop: Callable[[], bool] = lambda: False,
) -> None:
    """Bring one study to `n_trials` finished trials, in this process.

    Args:
        spec: the study.
        paths: the project.
        n_trials: finished trials the study shall have in total, from this call and from others.
        emit: told of trials and epochs.
        should_stop: asked at every validated epoch.

    Raises:
        InputError: a data set is unusable.
        StudyInterruptedError: `should_stop` said so.
    """
    Worker([spec], paths=paths, n_trials=n_trials, emit=emit, should_stop=should_stop).run()


class Worker:
    """Trains trials until every study has all of its own.

    Args:
        specs: the studies; an earlier one is begun first.
        paths: the project.
        n_trials: finished trials each study shall have in total.
        emit: told of trials and epochs.
        should_stop: asked at every validated epoch.
        deadline_s: no trial begins after this moment. [s since 1970, UTC]
        command_pid: process of the command that looks after this one.
        n_jobs: threads of a training.
    """

    def __init__(
        self,
        specs: Sequence[StudySpec],
        *,
        paths: ProjectPaths,
        n_trials: int,
        emit: Callable[[TuneEvent], None],
        should_stop: Callable[[], bool] = lambda: False,
        deadline_s: float | None = None,
        command_pid: int | None = None,
        n_jobs: int = 1,
    ) -> None:
        self._paths = paths
        self._n_trials = n_trials
        self._emit = emit
        self._should_stop = should_stop
        self._deadline_s = deadline_s
        self._n_jobs = n_jobs
        self._owner = this_owner(command_pid)
        self._studies = [_Course(spec, paths, n_trials, emit) for spec in specs]
        self._data: dict[str, StudyData] = {}

    def run(self) -> None:
        """Train until there is nothing left to begin.

        Raises:
            InputError: a data set is unusable.
            StudyInterruptedError: this process was asked to stop.
        """
        pause_s, has_told = FIRST_POLL_S, False
        left = list(self._studies)
        while left:
            if self._should_stop():
                raise StudyInterruptedError
            if self._deadline_s is not None and time.time() >= self._deadline_s:
                return
            study, slot = self._take(left)
            if study is not None and slot is not None:
                self._train(study, slot)
                left = [study, *(other for other in left if other is not study)]
                pause_s, has_told = FIRST_POLL_S, False
                continue
            left = [study for study in left if not study.is_done]
            if left:
                if not has_told and pause_s >= LONGEST_POLL_S:
                    has_told = self._tell_waiting(left)
                time.sleep(pause_s)
                pause_s = min(2.0 * pause_s, LONGEST_POLL_S)

    def _take(self, studies: Sequence["_Course"]) -> tuple["_Course | None", Slot | None]:
        """Claim a trial of the first study that has one to give."""
        for study in studies:
            if study.spec.warm_start and self._waits_for_another(study):
                continue
            if not study.is_checked:  # before a trial is spent on unusable data
                self._data_of(study.spec)
                study.is_checked = True
            answer = self._patiently(study, partial(self._claim, study))
            if isinstance(answer, Slot):
                return study, answer
            study.look(is_done=answer == "done")
        return None, None

    def _claim(self, study: "_Course") -> Answer:
        return take_slot(
            study.spec,
            study.store,
            n_trials=self._n_trials,
            owner=self._owner,
            neighbours=lambda: finished_neighbours(self._paths, study.spec),
        )

    def _waits_for_another(self, study: "_Course") -> bool:
        """Whether a smaller size of this command is unfinished, from which this one starts."""
        return any(not other.is_done and other.spec.n_train < study.spec.n_train for other in self._studies)

    def _train(self, study: "_Course", slot: Slot) -> None:
        claim = slot.claim
        try:
            study.tell("trial-started", index=claim.index, max_epochs=claim.max_epochs)
            record = attempt(
                study.spec,
                study.store,
                slot,
                self._data_of(study.spec),
                n_jobs=self._n_jobs,
                on_epoch=lambda report: self._hear(study, claim, report),
                keep=lambda work: self._patiently(study, work),
            )
        except BaseException:
            with suppress(InputError, OSError):  # whoever comes next finds that its owner has died
                release(study.store, claim)
            raise
        study.add(record)

    def _hear(self, study: "_Course", claim: Claim, report: EpochReport) -> None:
        if self._should_stop():
            raise StudyInterruptedError
        study.epoch(claim.index, report)

    def _data_of(self, spec: StudySpec) -> StudyData:
        found = self._data.pop(spec.name, None) or load_data(spec)
        self._data[spec.name] = found  # the latest last
        while len(self._data) > N_DATA_SETS:
            self._data.pop(next(iter(self._data)))
        return found

    def _patiently(self, study: "_Course", work: Callable[[], _T]) -> _T:
        return wait_out(
            work, tell=lambda line: study.tell("waiting", message=line), should_stop=self._should_stop
        )

    def _tell_waiting(self, studies: Sequence["_Course"]) -> bool:
        for study in studies:
            for trial in study.store.running():
                ours = self._owner.get("command", self._owner["pid"])
                if trial.owner.get("command", trial.owner.get("pid")) == ours:
                    continue  # a colleague under the same command, whose bars tell of it
                place = f"process {trial.owner.get('pid')} on {trial.owner.get('host')}"
                line = f"study {study.spec.name} waits for trial {trial.index}, which {place} trains"
                study.tell("joined", message=line)
                return True
        return False


class _Course:
    """A study as a worker sees it: its records, what is finished, and the events about it."""

    def __init__(
        self, spec: StudySpec, paths: ProjectPaths, n_trials: int, emit: Callable[[TuneEvent], None]
    ) -> None:
        self.spec = spec
        self.store = open_trials(paths, spec)
        self.is_done = False
        self.is_checked = False
        self._event = TuneEvent("study-started", spec.name, spec.n_train, n_trials, 0)
        self._emit = emit
        self._last_s = 0.0
        self._has_begun = False

    def look(self, *, is_done: bool) -> None:
        """Tell of what others have finished, and of the study's end."""
        self.is_done = is_done
        before = self._event.n_finished
        self._count()
        if is_done:
            self.tell("study-finished")
        elif self._event.n_finished > before:
            self.tell("study-started")

    def add(self, record: TrialRecord) -> None:
        """Tell of a finished trial."""
        self._count()
        self.tell(
            "trial-finished",
            index=record.index,
            epoch=record.n_epochs,
            max_epochs=int(record.config["max_epochs"]),
            state=record.state,
            value=record.value,
            message=record.reason,
        )

    def epoch(self, index: int, report: EpochReport) -> None:
        """Tell of an epoch, not too often."""
        if time.monotonic() - self._last_s >= EVENT_PERIOD_S:
            self._last_s = time.monotonic()
            self.tell(
                "epoch",
                index=index,
                epoch=report.epoch,
                max_epochs=report.max_epochs,
                value=report.validation_mae,
            )

    def tell(self, kind: EventKind, **changes: Any) -> None:
        """Tell of something."""
        if kind == "trial-started" and not self._has_begun:
            self._has_begun = True
            self._count()
            self._emit(replace(self._event, kind="study-started"))
        self._emit(replace(self._event, kind=kind, **changes))

    def _count(self) -> None:
        with suppress(InputError):  # only told
            records = self.store.records()
            best = best_record(records)
            self._event = replace(self._event, n_finished=len(records), best=best.value if best else None)


def finished_neighbours(paths: ProjectPaths, spec: StudySpec) -> list[Neighbour]:
    """Return the finished studies of the same case and label with another training-set size."""
    found = []
    for entry in list_studies(paths):
        is_kin = entry.label == spec.label and entry.digests.get("case") == spec.case_digest
        if is_kin and entry.n_train != spec.n_train:
            records = open_trials(paths, entry.name).records()
            if len(records) >= entry.n_planned:
                found.append(Neighbour(entry.n_train, entry.name, records))
    return found
