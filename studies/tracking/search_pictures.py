"""The pictures of one study: its trials' records put together as what `studies.report` draws."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from studies.report.records_search import SearchRecord, TrialCurve
from studies.report.wording import difference_unit
from studies.tracking.tracker import History
from studies.tuning.coordinates import to_settings
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord, best_record


def draw_search(
    spec: StudySpec,
    records: Sequence[TrialRecord],
    histories: Mapping[int, Callable[[], History]],
    folder: Path,
) -> list[Path]:
    """Draw every picture that a study's trials are enough for.

    Args:
        spec: the study.
        records: its finished trials.
        histories: reads a trial's learning curves, by index.
        folder: where the PNG files go.

    Returns:
        The files.
    """
    from studies.report.figures_search import search_figures
    from studies.tuning.importance import importances

    shares = importances(spec, records)
    best = best_record(records)
    keys = list(records[0].params) if records else []
    names = [next(iter(to_settings({key: 1}))) for key in keys]
    values = [[float(record.config.get(name, np.nan)) for name in names] for record in records]
    search = SearchRecord(
        n_train=spec.n_train,
        names=tuple(names),
        is_log=np.array(
            [key.startswith("log2_") or key in ("beta", "learning_rate") for key in keys], dtype=bool
        ),
        values=np.array(values, dtype=np.float64).reshape(len(records), len(names)),
        error=np.array([_error(record) for record in records], dtype=np.float64),
        state=tuple(record.state for record in records),
        is_best=np.array([record is best for record in records], dtype=bool),
        importance=np.array([shares.get(key, np.nan) for key in keys], dtype=np.float64),
        curves=tuple(
            curve
            for record in records
            if (curve := _curve(record, histories[record.index](), is_best=record is best))
        ),
    )
    return search_figures(search, folder, unit=difference_unit(spec.output_unit), footnote=spec.note)


def _error(record: TrialRecord) -> float:
    return record.value if record.value is not None and record.state != "failed" else float("nan")


def _curve(record: TrialRecord, history: History, *, is_best: bool) -> TrialCurve | None:
    if not record.has_epochs or "epoch" not in history or "validation_mae" not in history:
        return None
    epoch, error = np.asarray(history["epoch"]), np.asarray(history["validation_mae"], dtype=np.float64)
    judged = np.isfinite(error) & (error > 0)
    if not judged.any():
        return None
    return TrialCurve(epoch[judged].astype(np.int64), error[judged], record.state, is_best)
