"""A worker that knows of no other, for processes that load this module alone."""

from studies.paths import ProjectPaths
from studies.tuning.study_spec import StudySpec, TuneEvent
from studies.tuning.trial_worker import Worker


def work(spec: StudySpec, paths: ProjectPaths, n_trials: int) -> None:
    """Train trials until the study has all of its own."""
    Worker([spec], paths=paths, n_trials=n_trials, emit=_ignore).run()


def _ignore(event: TuneEvent) -> None:
    pass
