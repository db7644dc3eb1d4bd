"""What tuning came to, as the records that figures and tables are made of."""

from studies.report.figures_model import TrialsRecord
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
        (
            n_train, trial.state, trial.value, trial.metrics.get("test/mae"), trial.metrics.get("test/p90"),
            trial is one.best,
        )
        for n_train, one in studies.items()
        for trial in one.trials
        if trial.state in ("complete", "pruned", "failed")
    ]  # fmt: skip
    return TrialsRecord.of(ended) if ended else None
