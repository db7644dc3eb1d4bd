"""What tuning came to, as the records that figures and tables are made of."""

import numpy as np
from numpy.typing import NDArray

from studies.report.records_tuning import TrialsRecord
from studies.stages.pipeline import Study
from studies.tuning.study_results import TunedStudy, latest_studies, read_studies


def tuned_by_size(study: Study, *, baseline: bool = False) -> dict[int, TunedStudy]:
    """Return the latest study of each training-set size, of this case and label.

    Args:
        study: the study.
        baseline: the PCA + GP that was fitted for comparison instead.
    """
    latest = latest_studies(read_studies(study.paths, label=study.label), study.case.digest)
    return {n: one for (n, is_baseline), one in sorted(latest.items()) if is_baseline == baseline}


def trials_record(studies: dict[int, TunedStudy]) -> TrialsRecord | None:
    """Return all trials that have ended as one record, None where there are none."""
    ended = [
        (one, trial)
        for one in studies.values()
        for trial in one.trials
        if trial.state in ("complete", "pruned", "failed")
    ]
    if not ended:
        return None

    def metric(name: str) -> NDArray[np.float64]:
        return np.array([trial.metrics.get(name, np.nan) for _, trial in ended], dtype=np.float64)

    values = [np.nan if trial.value is None else trial.value for _, trial in ended]
    return TrialsRecord(
        n_train=np.array([one.spec.n_train for one, _ in ended], dtype=np.int64),
        state=tuple(trial.state for _, trial in ended),
        validation_mae=np.array(values, dtype=np.float64),
        test_mae=metric("test/mae"),
        test_p90=metric("test/p90"),
        is_best=np.array([trial is one.best for one, trial in ended]),
    )
