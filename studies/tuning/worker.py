"""A worker process: runs trials of studies, one after the other, until they have as many as planned.

`python -P -m studies.tuning.worker STUDY ...`, in the project's folder, on any machine with the same storage.
`studies tune` starts workers itself, and they end with it.
"""

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import optuna
from optuna.exceptions import StorageInternalError, UpdateFinishedTrialError
from optuna.trial import FrozenTrial

from simulation.errors import InputError, MachineError
from studies.paths import ProjectPaths, find_project
from studies.results.declaration import StudyDeclaration
from studies.results.objective import ObjectiveDeclaration
from studies.tracking.quiet_mlflow import MlflowException
from studies.tracking.runs import RunStore
from studies.tracking.sending import begin_sending, runs_sent
from studies.tracking.trial_run import TrialRun, end_run
from studies.tuning import attempts
from studies.tuning.live_trial import LiveTrial, Objective, TrialFailedError, finite_values
from studies.tuning.sampler import make_pruner, sampler_of_place
from studies.tuning.storage import open_storage, study_locked
from studies.tuning.surrogate_trials import SurrogateTrials
from studies.words.quiet_loggers import working


class Worker:
    """Works on trials of one study.

    Args:
        paths: the project.
        name: name of the study.
        n_threads: folds of a cross-validation that are trained at once.
        objective: what its trials do; None where they train surrogates.
    """

    def __init__(
        self, paths: ProjectPaths, name: str, n_threads: int = 1, objective: Objective | None = None
    ) -> None:
        self._paths, self._storage = paths, open_storage(paths)
        try:
            study = optuna.load_study(study_name=name, storage=self._storage)
        except KeyError:
            raise InputError(f"there is no study {name!r}; type: studies status") from None
        self._study, self._runs = study, RunStore(paths)
        self._spec: StudyDeclaration
        if objective is None:
            self._spec = spec = attempts.declaration_of(study)
            objective = SurrogateTrials(spec, paths, n_threads)
        else:
            self._spec = attempts.declaration_of(study, ObjectiveDeclaration)
        self._objective = objective
        study.pruner = make_pruner(self._spec.pruner)

    def run(self, *, until_s: float | None = None) -> None:
        """Run trials until the study has as many as planned.

        Args:
            until_s: no trial begins after this moment of `time.monotonic`. [s]
        """
        while until_s is None or time.monotonic() < until_s:
            with study_locked(self._storage, self._paths, self._spec.name) as release:
                attempts.retry_lost(self._study)
                allowed = attempts.n_allowed(self._study)
                if not attempts.is_unfinished(self._study.get_trials(deepcopy=False), allowed):
                    return
                # Before the sampler is made: its seed follows from the place.
                place = attempts.lease_next(self._storage, self._study)
                self._study.sampler = sampler_of_place(self._spec, place)
                # Inside the lock, which the trial itself gives back once it has begun.
                self._run_trial(release)

    def _run_trial(self, on_begun: Callable[[], None]) -> None:
        """Let Optuna run one trial; a trial that this process could not end is run again."""
        self._number: int | None = None
        self._is_lost = False

        def objective(trial: optuna.Trial) -> float | list[float]:
            self._number = trial.number
            try:
                return self._tried(trial, on_begun)
            finally:
                # While Optuna has not ended it yet: a state that is final now was set by another process.
                self._is_lost = self._study.get_trials(deepcopy=False)[trial.number].state.is_finished()

        try:
            self._study.optimize(objective, n_trials=1, catch=(TrialFailedError,), callbacks=[self._end])
        except BaseException:
            number: int | None = self._number
            if number is None:
                raise
            ended = self._study.get_trials()[number]
            with suppress(Exception):
                self._end(self._study, ended)
            if self._is_lost:  # this process stood still, so another one has ended the trial
                return
            # A full disk or a Ctrl-C is no fault of the configuration.
            attempts.run_again(self._study, ended)
            raise

    def _tried(self, trial: optuna.Trial, on_begun: Callable[[], None]) -> float | list[float]:
        spec, trials = self._spec, self._study.get_trials(deepcopy=False)
        # Another program may have taken the leased trial at that very moment.
        if not attempts.is_owned(trials[trial.number]):
            attempts.set_owner(self._storage, self._study, trial.number)
        on_begun()
        if trial.relative_params and attempts.PROPOSED_BY not in trial.user_attrs:
            trial.set_user_attr(attempts.PROPOSED_BY, spec.sampler["name"])
        usual = spec.trial_seed(attempts.place_of(trials[trial.number], trials), spec.seed_use)
        seed = int(trial.user_attrs.get(attempts.SEED, usual))  # which a trial that is made again has
        about = {**self._study.user_attrs.get(attempts.PROVENANCE, {}), "declaration": spec.to_dict()}
        study_run = str(self._study.user_attrs.get(attempts.RUN_ID, ""))

        def begin(params: dict[str, Any]) -> TrialRun:
            return TrialRun(self._runs, spec, study_run, trial=trial.number, params=params, about=about)

        live = LiveTrial(trial, spec, seed, begin, attempts.enqueued(trials[trial.number]))
        try:
            values = finite_values(self._objective(live), spec.value_names)
        except optuna.TrialPruned as pruned:
            live.note(live.stopped or str(pruned) or "pruned by the objective")
            raise
        except (OSError, MachineError, StorageInternalError, UpdateFinishedTrialError, MlflowException):
            raise  # a full disk or a database that is away is no fault of a configuration
        except Exception as error:
            # Whatever else a configuration provokes (divergence, memory) is its result.
            said = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
            is_ours = isinstance(error, TrialFailedError)
            live.note(reason := said if is_ours else f"{type(error).__name__}: {said}")
            raise TrialFailedError(reason) from error
        live.note("")
        return values

    def _end(self, study: optuna.Study, trial: FrozenTrial) -> None:
        run_id = trial.user_attrs.get(attempts.RUN_ID)
        if run_id:
            end_run(self._runs, run_id, trial, self._spec)


def run_studies(
    paths: ProjectPaths | None,
    names: Sequence[str],
    until_s: float | None,
    n_threads: int = 1,
    objective: Objective | None = None,
) -> int:
    """Run the trials of studies; the last line of standard error says why it could not.

    Args:
        paths: the project; None for that of the working folder.
        names: names of the studies.
        until_s: no trial begins after this moment of `time.monotonic`. [s]
        n_threads: folds of a cross-validation that are trained at once.
        objective: what the trials do; None where they train surrogates.

    Returns:
        The exit code: 2 where a study cannot be used.
    """
    try:
        with working():
            project = paths or find_project(None)
            begin_sending(project)
            for name in names:
                Worker(project, name, n_threads, objective).run(until_s=until_s)
    except InputError as error:
        sys.stderr.write(f"{error}\n")
        return 2
    return 0


def main() -> int:
    """Run the trials of the studies that the command line names."""
    parser = argparse.ArgumentParser(prog="python -P -m studies.tuning.worker", description=__doc__)
    parser.add_argument("studies", nargs="+", metavar="STUDY", help="name of an Optuna study")
    parser.add_argument("--until", type=float, help="no trial begins after this moment, in s since 1970")
    chosen = parser.parse_args()
    with runs_sent(lambda line: print(line, file=sys.stderr)):
        return run_studies(None, chosen.studies, chosen.until)


if __name__ == "__main__":
    sys.exit(main())
