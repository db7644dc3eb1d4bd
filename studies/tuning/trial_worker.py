"""Run one Optuna study trial by trial, in any process: choose, train, judge, record."""

import logging
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pelsvae.device import resolve_device
from pelsvae.training import EpochReport
from simulation.errors import InputError
from simulation.file_lock import FileLock
from studies.recipe import file_digest
from studies.tracking.origin import environment
from studies.tuning.champion import WEIGHTS_FILE
from studies.tuning.claim import this_owner
from studies.tuning.pruning import Pruner
from studies.tuning.search_space import proposal_of, propose
from studies.tuning.study_data import StudyData, load_data
from studies.tuning.study_spec import EventKind, StudySpec, TuneEvent
from studies.tuning.study_store import StudyStore
from studies.tuning.trial_record import (
    SURROGATE_FOLDER,
    TrialRecord,
    best_record,
    keep_only_best_surrogate,
    read_records,
    write_record,
)
from studies.tuning.trial_store import StudyEntry
from studies.tuning.trial_store_files import FileTrials
from studies.tuning.trial_training import TrialOutcome, train_trial

EVENT_PERIOD_S = 0.25

logger = logging.getLogger(__name__)


class StudyInterruptedError(Exception):
    """The study was asked to stop; its running trial will be run again."""


def run_study(
    spec: StudySpec,
    *,
    mlruns: Path,
    n_trials: int,
    emit: Callable[[TuneEvent], None],
    should_stop: Callable[[], bool] = lambda: False,
) -> None:
    """Bring a study to `n_trials` finished trials.

    Args:
        spec: the study.
        mlruns: folder of Optuna's journal and of the trials' records.
        n_trials: finished trials the study shall have in total, from this call and earlier ones.
        emit: told of trials and epochs.
        should_stop: asked at every validated epoch.

    Raises:
        InputError: another process is working on the study, or a data set is unusable.
        StudyInterruptedError: `should_stop` said so.
    """
    folder = spec.folder(mlruns)
    lock = FileLock(spec.lock_file(mlruns))
    if not lock.try_acquire():
        raise InputError(f"study {spec.name} is being tuned by another process; wait for it or stop it")
    try:
        store = StudyStore(spec, mlruns)
        store.reap()
        store.mend(read_records(folder))
        data = load_data(spec)
        entry = StudyEntry.of(spec, n_planned=n_trials, created_s=time.time())
        FileTrials(mlruns, spec.name).describe(entry)
        progress = _Progress(spec, folder, n_trials, emit)
        progress.tell("study-started")
        try:
            while progress.n_finished < n_trials:
                if should_stop():
                    raise StudyInterruptedError
                _run_trial(spec, store, folder, data, progress=progress, should_stop=should_stop)
        except BaseException:
            store.reap()
            raise
        progress.tell("study-finished")
    finally:
        lock.release()


def _run_trial(
    spec: StudySpec,
    store: StudyStore,
    folder: Path,
    data: StudyData,
    *,
    progress: "_Progress",
    should_stop: Callable[[], bool],
) -> None:
    """Choose, train and record the next trial."""
    index = progress.n_finished
    if interrupted := store.params_of_interrupted(index):
        proposal = proposal_of(spec, index, interrupted, origin="retry")
    else:
        proposal = propose(spec, index, progress.records)
    params, config, seed = proposal.params, proposal.config, proposal.seed
    pruner = Pruner(spec, index, progress.records)
    owner, started_s = this_owner(), time.time()
    handle = store.start(
        index,
        params=params,
        attributes={"seed": seed, "config": config.to_dict(), "owner": owner, "started_s": started_s},
    )
    progress.tell("trial-started", index=index, max_epochs=config.max_epochs)

    def on_epoch(report: EpochReport) -> None:
        if should_stop():
            raise StudyInterruptedError
        progress.epoch(report)

    def is_hopeless(epoch: int, validation_mae: float) -> bool:
        handle.report(validation_mae, epoch)
        return pruner.is_hopeless(epoch, validation_mae)

    tick = time.perf_counter()
    outcome = TrialOutcome()
    try:
        train_trial(spec, config, seed, data, outcome=outcome, on_epoch=on_epoch, is_hopeless=is_hopeless)
    except (StudyInterruptedError, OSError):
        raise  # a full disk is no fault of a configuration
    except Exception as error:
        # Whatever a configuration provokes (divergence, memory) is a result of the trial; the study goes on.
        outcome.state, outcome.reason = "failed", f"{type(error).__name__}: {error}"
        logger.info("%s trial %d failed: %s", spec.name, index, outcome.reason)
    fitted = outcome.fitted
    record = TrialRecord(
        study=spec.name,
        n_train=spec.n_train,
        index=index,
        state=outcome.state,
        reason=outcome.reason,
        params=params,
        config=config.to_dict(),
        seed=seed,
        metrics=outcome.metrics,
        reports=outcome.reports,
        n_epochs=outcome.n_epochs,
        best_epoch=fitted.best_epoch if fitted else 0,
        n_rows=len(data.train[0]),
        started_s=started_s,
        wall_s=time.perf_counter() - tick,
        digests=spec.digests,
        owner=owner,
        origin=proposal.origin,
    )
    history: Mapping[str, Any] = fitted.history if fitted else outcome.history
    device = resolve_device(config.device).type
    record = replace(record, environment=environment(device))
    with tempfile.TemporaryDirectory(dir=folder, prefix=".weights-") as scratch:
        weights = Path(scratch) / SURROGATE_FOLDER if fitted else None
        if fitted and weights:
            fitted.surrogate.save(weights)
            record = replace(record, weights_sha256=file_digest(weights / WEIGHTS_FILE))
        write_record(folder, record, {name: np.asarray(curve) for name, curve in history.items()}, weights)
    store.finish(handle.number, record)
    keep_only_best_surrogate(folder)
    progress.add(record)


class _Progress:
    """The finished trials of a running study and the events about it."""

    def __init__(
        self, spec: StudySpec, folder: Path, n_trials: int, emit: Callable[[TuneEvent], None]
    ) -> None:
        self._event = TuneEvent("study-started", spec.name, spec.n_train, n_trials, 0)
        self._emit = emit
        self._records = read_records(folder)
        self._last_s = 0.0

    @property
    def n_finished(self) -> int:
        return len(self._records)

    @property
    def records(self) -> list[TrialRecord]:
        return list(self._records)

    def add(self, record: TrialRecord) -> None:
        self._records.append(record)
        self.tell(
            "trial-finished",
            index=record.index,
            epoch=record.n_epochs,
            max_epochs=int(record.config["max_epochs"]),
            state=record.state,
            value=record.value,
            message=record.reason,
        )

    def epoch(self, report: EpochReport) -> None:
        if time.monotonic() - self._last_s >= EVENT_PERIOD_S:
            self._last_s = time.monotonic()
            self.tell(
                "epoch",
                index=self.n_finished,
                epoch=report.epoch,
                max_epochs=report.max_epochs,
                value=report.validation_mae,
            )

    def tell(self, kind: EventKind, **changes: Any) -> None:
        best = best_record(self._records)
        event = replace(self._event, kind=kind, n_finished=self.n_finished, best=best.value if best else None)
        self._emit(replace(event, **changes))
