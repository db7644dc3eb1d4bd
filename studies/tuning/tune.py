"""Tune the surrogates of several training-set sizes at once: one Optuna study each, in worker processes."""

from collections.abc import Callable, Sequence

from simulation.workers.parallel import available_cores
from studies.paths import ProjectPaths
from studies.tracking.tracker import NullTracker, RunStatus, Tracker
from studies.tuning.champion import write_champion
from studies.tuning.crew import Crew
from studies.tuning.study_spec import StudySpec, StudySummary, TuneEvent
from studies.tuning.trial_record import (
    TrialRecord,
    best_record,
    read_history,
    read_record,
    read_records,
    summarize,
)


def tune(
    studies: Sequence[StudySpec],
    *,
    paths: ProjectPaths,
    n_trials: int,
    n_jobs: int | None = None,
    tracker: Tracker | None = None,
    on_event: Callable[[TuneEvent], None] | None = None,
) -> list[StudySummary]:
    """Bring every study to `n_trials` finished trials and crown its best surrogate.

    Studies run side by side, the largest training set first; the trials of a study run one after the other in
    a process of their own with one thread, so that a study's trials do not depend on `n_jobs`, on
    interruptions or on how often it was extended.

    Args:
        studies: the studies.
        paths: the project.
        n_trials: finished trials per study in total, those of earlier calls included.
        n_jobs: worker processes; None means one per core that this process may use.
        tracker: is told of studies, trials and champions, always from this process.
        on_event: told of trials and epochs, a few times a second at most.

    Returns:
        One summary per study, in the order given.

    Raises:
        InputError: a study cannot be run as declared, or another process is running it.
        studies.tuning.crew.TuningError: a worker failed for a reason that is not a trial's.
        KeyboardInterrupt: after the workers have stopped and their trials have been marked as interrupted.
    """
    desk = _Desk(paths, n_trials, tracker or NullTracker(), on_event or (lambda event: None))
    unfinished = sorted(
        (spec for spec in studies if not desk.is_finished(spec)), key=lambda spec: -spec.n_train
    )
    crew = Crew(mlruns=paths.mlruns, n_trials=n_trials, n_workers=n_jobs or available_cores())
    try:
        for spec in studies:
            desk.open(spec)
        for spec, event in crew.run(unfinished):
            desk.hear(spec, event)
    except BaseException:
        crew.dismiss()
        for spec in unfinished:
            desk.close(spec, "KILLED")
        raise
    return [desk.close(spec, "FINISHED") for spec in studies]


class _Desk:
    """Keeps the tracker and the champions in step with the records on disk."""

    def __init__(
        self, paths: ProjectPaths, n_trials: int, tracker: Tracker, on_event: Callable[[TuneEvent], None]
    ) -> None:
        self._paths = paths
        self._n_trials = n_trials
        self._tracker = tracker
        self._on_event = on_event
        self._summaries: dict[str, StudySummary] = {}

    def open(self, spec: StudySpec) -> None:
        self._tracker.start_study(spec, n_trials=self._n_trials)
        for record in read_records(spec.folder(self._paths.mlruns)):
            self._track_trial(spec, record)

    def is_finished(self, spec: StudySpec) -> bool:
        return len(read_records(spec.folder(self._paths.mlruns))) >= self._n_trials

    def hear(self, spec: StudySpec, event: TuneEvent) -> None:
        if event.kind == "trial-finished":
            record = read_record(spec.folder(self._paths.mlruns), event.index)
            if record is not None:
                self._track_trial(spec, record)
        elif event.kind == "study-finished":
            self.close(spec, "FINISHED")
        self._on_event(event)

    def close(self, spec: StudySpec, status: RunStatus) -> StudySummary:
        """Crown the best surrogate of a study, once, and close its run."""
        if spec.name in self._summaries:
            return self._summaries[spec.name]
        folder = spec.folder(self._paths.mlruns)
        records = read_records(folder)
        for record in records if status == "FINISHED" else []:
            self._track_trial(spec, record)  # nobody has told of one that failed with its process
        best = best_record(records)
        champion = None
        if best is not None and status == "FINISHED":
            champion = self._paths.champion(spec.label, spec.n_train)
            write_champion(
                spec,
                best,
                study_folder=folder,
                folder=champion,
                run_id=self._tracker.trial_run_id(spec, best.key),
            )
            self._tracker.register_champion(spec, champion)
        summary = summarize(spec, records, champion)
        self._tracker.finish_study(spec, summary, status)
        self._summaries[spec.name] = summary
        return summary

    def _track_trial(self, spec: StudySpec, record: TrialRecord) -> None:
        folder = spec.folder(self._paths.mlruns)
        self._tracker.log_trial(spec, record, lambda: read_history(folder, record.index))
