"""One attempt at a trial: train beside a beating heart, judge, record."""

import math
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import TracebackType
from typing import Any, Literal

import numpy as np

from pelsvae.device import resolve_device
from pelsvae.epochs import EpochReport
from simulation.errors import InputError
from studies.recipe import file_digest
from studies.tracking.origin import environment
from studies.tuning.champion import WEIGHTS_FILE
from studies.tuning.claim import BEAT_S, Claim
from studies.tuning.outage import StudyInterruptedError
from studies.tuning.pruning import Pruner
from studies.tuning.search_space import proposal_of
from studies.tuning.slots import Slot
from studies.tuning.study_data import StudyData
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import SURROGATE_FOLDER, TrialRecord
from studies.tuning.trial_store import TrialStore
from studies.tuning.trial_training import TrialOutcome, train_trial

_NO_MEMORY = ("out of memory", "can't allocate memory", "cannot allocate memory")


class _TimeLimitError(Exception):
    """The trial has taken as long as a trial may."""


class Heart:
    """Tells a store, beside the training, that a trial's owner lives and how far the trial is.

    Args:
        store: the study's records.
        claim: the claim on the trial.
    """

    def __init__(self, store: TrialStore, claim: Claim) -> None:
        self._store = store
        self._claim = claim
        self._epoch = 0
        self._value: float | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="heart", daemon=True)

    def note(self, report: EpochReport) -> None:
        """Hear how far the trial is."""
        self._epoch = report.epoch
        self._value = report.validation_mae if math.isfinite(report.validation_mae) else None

    def __enter__(self) -> "Heart":
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()

    def _beat(self) -> None:
        while not self._stop.wait(BEAT_S):
            with suppress(InputError, OSError):  # a store that is away is waited for at the trial's end
                self._store.beat(self._claim, epoch=self._epoch, value=self._value)


def attempt(
    spec: StudySpec,
    store: TrialStore,
    slot: Slot,
    data: StudyData,
    *,
    n_jobs: int,
    on_epoch: Callable[[EpochReport], None],
    keep: Callable[[Callable[[], Any]], Any],
) -> TrialRecord:
    """Train the surrogate of a claimed trial and record how it went.

    Args:
        spec: the study.
        store: its records.
        slot: the trial.
        data: the study's data.
        n_jobs: threads of the training.
        on_epoch: told of every validated epoch; a `StudyInterruptedError` from it ends the attempt.
        keep: calls what writes to the store, as often as it takes.

    Returns:
        The record, as it was written.
    """
    claim = slot.claim
    config = proposal_of(spec, claim.index, claim.params, origin=claim.origin).config
    pruner = Pruner(spec, slot.finished)
    outcome = TrialOutcome()
    tick = time.perf_counter()

    with Heart(store, claim) as heart:

        def hear(report: EpochReport) -> None:
            on_epoch(report)
            heart.note(report)
            is_late = spec.max_trial_s is not None and time.perf_counter() - tick >= spec.max_trial_s
            if is_late and outcome.n_epochs:
                raise _TimeLimitError

        try:
            train_trial(
                spec,
                config,
                claim.seed,
                data,
                n_jobs=n_jobs,
                outcome=outcome,
                on_epoch=hear,
                is_hopeless=pruner.is_hopeless,
            )
        except (StudyInterruptedError, OSError):
            raise  # a full disk is no fault of a configuration
        except _TimeLimitError:
            outcome.state = "pruned"
            outcome.reason = f"reached its limit of {spec.max_trial_s:g} s at epoch {outcome.n_epochs}"
            outcome.metrics = {"val/mae": min(outcome.history["validation_mae"])}
        except Exception as error:
            # Whatever a configuration provokes (divergence, memory) is its result; the study goes on.
            outcome.state, outcome.reason, outcome.metrics = "failed", failure_reason(error), {}
        wall_s = time.perf_counter() - tick
        return _keep(spec, store, claim, outcome, wall_s=wall_s, n_rows=len(data.train[0]), keep=keep)


def _keep(
    spec: StudySpec,
    store: TrialStore,
    claim: Claim,
    outcome: TrialOutcome,
    *,
    wall_s: float,
    n_rows: int,
    keep: Callable[[Callable[[], Any]], Any],
) -> TrialRecord:
    fitted, device = outcome.fitted, spec.base_config.device
    curves: Mapping[str, Any] = fitted.history if fitted else outcome.history
    history = {name: np.asarray(curve) for name, curve in curves.items()}

    def record(weights: Path | None) -> TrialRecord:
        return TrialRecord(
            study=spec.name,
            n_train=spec.n_train,
            index=claim.index,
            state=outcome.state,
            reason=outcome.reason,
            params=claim.params,
            config=claim.config,
            seed=claim.seed,
            started_s=claim.started_s,
            wall_s=wall_s,
            digests=spec.digests,
            owner=claim.owner,
            origin=claim.origin,
            attempts=claim.attempt,
            environment=dict(_environment(device)),
            metrics=outcome.metrics,
            reports=outcome.reports,
            n_epochs=outcome.n_epochs,
            best_epoch=fitted.best_epoch if fitted else 0,
            n_rows=n_rows,
            weights_sha256=file_digest(weights / WEIGHTS_FILE) if weights else "",
        )

    def write() -> TrialRecord:
        with tempfile.TemporaryDirectory(prefix="studies-weights-") as scratch:
            weights = Path(scratch) / SURROGATE_FOLDER if fitted else None
            if fitted and weights:
                fitted.surrogate.save(weights)
            made = record(weights)
            store.write(made, history, weights)
            return made

    made: TrialRecord = keep(write)
    keep(store.keep_only_best)
    return made


@cache
def _environment(device: Literal["auto", "cpu", "cuda"]) -> Mapping[str, str]:
    return environment(resolve_device(device).type)


def failure_reason(error: Exception) -> str:
    """Say in a line why a training failed."""
    said = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
    if isinstance(error, MemoryError) or any(sign in said.lower() for sign in _NO_MEMORY):
        return f"out of memory ({said or type(error).__name__})"
    return f"{type(error).__name__}: {said}"
