"""What tuning left on disk, read back as the records that figures and tables are made of."""

import numpy as np
from numpy.typing import NDArray

from studies.report.records_tuning import LearningCurves, TrialsRecord
from studies.stages.pipeline import Study, read_json
from studies.tuning.trial_record import TrialRecord, best_record
from studies.tuning.trial_store import TrialStore, open_trials


def tuned_trials(study: Study) -> dict[int, tuple[TrialStore, list[TrialRecord]]]:
    """Return, per training-set size of the last tuning, the store of its trials and the trials."""
    manifest = read_json(study.results / "tune.json")
    found = {}
    for summary in manifest["summary"]["studies"] if manifest else []:
        store = open_trials(study.paths, summary["study"])
        records = store.records()
        if records and records[0].digests.get("case") == study.case.digest:
            found[int(summary["n_train"])] = (store, records)
    return found


def trials_record(trials: dict[int, tuple[TrialStore, list[TrialRecord]]]) -> TrialsRecord | None:
    """Return all trials as one record, None where there are none."""
    records = [(record, best_record(group)) for _, group in trials.values() for record in group]
    if not records:
        return None

    def metric(name: str) -> NDArray[np.float64]:
        return np.array([record.metrics.get(name, np.nan) for record, _ in records], dtype=np.float64)

    return TrialsRecord(
        n_train=np.array([record.n_train for record, _ in records], dtype=np.int64),
        state=tuple(record.state for record, _ in records),
        validation_mae=metric("val/mae"),
        test_mae=metric("test/mae"),
        test_p90=metric("test/p90"),
        is_best=np.array([record is best for record, best in records]),
    )


def learning_curves(trials: dict[int, tuple[TrialStore, list[TrialRecord]]]) -> tuple[LearningCurves, ...]:
    """Return the learning curves of the best trial of each size."""
    curves = []
    for n_train, (store, records) in trials.items():
        best = best_record(records)
        if best is None or not best.has_epochs:
            continue
        history = store.history(best.index)
        terms = [name for name in history if name not in ("epoch", "validation_mae")]
        curves.append(
            LearningCurves(
                n_train=n_train,
                epoch=history["epoch"].astype(np.int64),
                validation_mae=history["validation_mae"],
                terms=tuple((name, history[name]) for name in terms),
                best_epoch=best.best_epoch,
                stop_reason=best.reason,
            )
        )
    return tuple(curves)
