"""Optuna's side of a study: the journal, its lock, and what a killed process leaves behind in it."""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend, JournalFileOpenLock
from optuna.trial import FrozenTrial, Trial, create_trial
from optuna.trial import TrialState as OptunaState

from simulation.errors import InputError
from simulation.file_lock import FileLock
from studies.tuning.search_space import distributions
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord, read_record, write_record

JOURNAL = "optuna.journal"
N_SPARED_TRIALS = 4  # completed trials before the first may be pruned
INTERRUPTED = "interrupted"

_STATES = {"complete": OptunaState.COMPLETE, "pruned": OptunaState.PRUNED, "failed": OptunaState.FAIL}


class StudyStore:
    """One study in Optuna's journal; to be used by whoever holds the study's lock.

    Args:
        spec: the study.
        mlruns: folder of the journal and of the trials' records.
    """

    def __init__(self, spec: StudySpec, mlruns: Path) -> None:
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        mlruns.mkdir(parents=True, exist_ok=True)
        journal = mlruns / JOURNAL
        self._spec = spec
        self._folder = spec.folder(mlruns)
        try:
            self._storage = JournalStorage(JournalFileBackend(str(journal), lock_obj=_JournalLock(journal)))
        except (ValueError, KeyError, TypeError) as error:  # whatever Optuna stumbles over when it reads
            raise InputError(
                f"{journal} is damaged ({type(error).__name__}: {error}); move it away, the finished trials "
                "in mlruns/trials are written to a new one"
            ) from None
        self._study = self._open()

    def start(self, index: int, *, params: dict[str, float | int], attributes: dict[str, Any]) -> Trial:
        """Note that a trial runs, in one write.

        Args:
            index: place of the trial in the study.
            params: its hyperparameters in search coordinates.
            attributes: what a reader of the store should know of it, among it `owner` and `started_s`.
        """
        self._study.add_trial(
            create_trial(
                state=OptunaState.RUNNING,
                params=dict(params),
                distributions=distributions(self._spec.search),
                user_attrs={"index": index, **attributes},
            )
        )
        return Trial(self._study, self._trials()[-1]._trial_id)

    def finish(self, number: int, record: TrialRecord) -> None:
        """Finish a running trial as its record says.

        Args:
            number: Optuna's number of the trial.
            record: the record, already on disk.
        """
        Trial(self._study, self._trials()[number]._trial_id).set_user_attr("result", _result(record))
        value = record.value if record.state == "complete" else None
        self._study.tell(number, value, state=_STATES[record.state])

    def params_of_interrupted(self, index: int) -> dict[str, float | int]:
        """Return the hyperparameters of an interrupted trial, empty where none was interrupted there."""
        for trial in reversed(self._trials()):
            if trial.user_attrs.get("reason") == INTERRUPTED and trial.user_attrs["index"] == index:
                return dict(trial.params)
        return {}

    def reap(self, *, crash: str = "") -> None:
        """Finish the trials that a dead process left running.

        A trial whose record is on disk is finished as the record says. Any other one becomes an interrupted
        failure, which does not count: the next trial repeats it with the same parameters and seed.

        Args:
            crash: how the process ended where it was not stopped by us. A trial that brings its process down
                twice is recorded as failed, lest it do so for ever.
        """
        trials = self._trials()
        for lost in [trial for trial in trials if trial.state == OptunaState.RUNNING]:
            index = lost.user_attrs["index"]
            record = read_record(self._folder, index)
            if record is None and crash and any(_crashed_at(trial, index) for trial in trials):
                record = self._crash_record(lost, f"its process ended twice ({crash}); out of memory?")
                write_record(self._folder, record, {})
            if record is not None and record.started_s == lost.user_attrs["started_s"]:
                self.finish(lost.number, record)
                continue
            handle = Trial(self._study, lost._trial_id)
            handle.set_user_attr("reason", INTERRUPTED)
            if crash:
                handle.set_user_attr("crashed", crash)
            self._study.tell(lost.number, state=OptunaState.FAIL)

    def mend(self, records: Sequence[TrialRecord]) -> None:
        """Rebuild the study from the records where the two tell different stories, as after a lost journal.

        Args:
            records: all finished trials; what they say is true.
        """
        known = [
            trial.user_attrs["started_s"]
            for trial in self._trials()
            if trial.state.is_finished() and trial.user_attrs.get("reason") != INTERRUPTED
        ]
        if known == [record.started_s for record in records]:
            return
        optuna.delete_study(study_name=self._spec.name, storage=self._storage)
        self._study = self._open()
        for record in records:
            self._study.add_trial(
                create_trial(
                    state=_STATES[record.state],
                    value=record.value,
                    params=dict(record.params),
                    distributions=distributions(self._spec.search),
                    intermediate_values={int(step): value for step, value in record.reports.items()},
                    user_attrs={
                        "index": record.index,
                        "seed": record.seed,
                        "config": record.config,
                        "owner": record.owner,
                        "started_s": record.started_s,
                        "result": _result(record),
                    },
                )
            )

    def _open(self) -> optuna.Study:
        return optuna.create_study(
            storage=self._storage,
            study_name=self._spec.name,
            direction="minimize",
            pruner=optuna.pruners.MedianPruner(n_startup_trials=N_SPARED_TRIALS),
            load_if_exists=True,
        )

    def _trials(self) -> list[FrozenTrial]:
        return self._study.get_trials(deepcopy=False)

    def _crash_record(self, lost: FrozenTrial, reason: str) -> TrialRecord:
        return TrialRecord(
            study=self._spec.name,
            n_train=self._spec.n_train,
            index=lost.user_attrs["index"],
            state="failed",
            reason=reason,
            params=dict(lost.params),
            config=lost.user_attrs["config"],
            seed=lost.user_attrs["seed"],
            started_s=lost.user_attrs["started_s"],
            wall_s=time.time() - lost.user_attrs["started_s"],
            digests=self._spec.digests,
            owner=lost.user_attrs["owner"],
        )


class _JournalLock(JournalFileOpenLock):
    """Optuna's journal lock, released with its owner, that cuts off the half line of a killed writer."""

    def __init__(self, journal: Path) -> None:
        self._journal = journal
        self._lock = FileLock(journal.with_name(f"{journal.name}.lock"))

    def acquire(self) -> bool:
        self._lock.acquire()
        with self._journal.open("r+b") as file:
            size = file.seek(0, os.SEEK_END)
            if size:
                file.seek(size - 1)
                if file.read(1) != b"\n":
                    file.seek(0)
                    file.truncate(file.read().rfind(b"\n") + 1)
        return True

    def release(self) -> None:
        self._lock.release()


def _result(record: TrialRecord) -> dict[str, Any]:
    return {"reason": record.reason, "n_epochs": record.n_epochs, "wall_s": record.wall_s, **record.metrics}


def _crashed_at(trial: FrozenTrial, index: int) -> bool:
    return bool(trial.user_attrs.get("crashed")) and trial.user_attrs["index"] == index
