"""What tuning came to, as the records that figures and tables are made of."""

from studies.reporting.figures_model import TrialsRecord
from studies.results.trials import TunedStudy
from studies.task import Task
from studies.tuning.study_results import latest_studies, read_studies


def tuned_by_size(task: Task, *, baseline: bool = False) -> dict[int, TunedStudy]:
    """Return the latest study of each training-set size, of this case and label.

    Args:
        task: the task.
        baseline: the PCA + GP that was fitted for comparison instead.
    """
    latest = latest_studies(read_studies(task.paths, label=task.label), task.case.digest)
    return {n: one for (n, is_baseline), one in sorted(latest.items()) if is_baseline == baseline}


def trials_record(studies: dict[int, TunedStudy]) -> TrialsRecord | None:
    """Return all trials that have ended as one record, None where there are none."""
    ended = [
        (
            n_train, trial.state, trial.value,
            trial.metrics.get(f"{one.spec.judged_by}/mae"), trial.metrics.get(f"{one.spec.judged_by}/p90"),
            trial is one.best_trial,
        )
        for n_train, one in studies.items()
        for trial in one.trials
        if trial.state in ("complete", "pruned", "failed")
    ]  # fmt: skip
    return TrialsRecord.of(ended) if ended else None
