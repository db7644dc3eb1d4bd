"""A worker process: runs trials of studies, one after the other, until they have as many as planned.

`python -P -m studies.tuning.worker STUDY ...`, in the project's folder, on any machine with the same storage.
`studies tune` starts workers itself, and they end with it.
"""

import argparse
import math
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import optuna
from optuna.exceptions import StorageInternalError, UpdateFinishedTrialError
from optuna.trial import FrozenTrial, TrialState

from pelsvae.device import resolve_device
from pelsvae.epochs import EpochReport, StopTraining
from pelsvae.surrogate_files import save_surrogate
from simulation.errors import InputError, MachineError
from studies.paths import ProjectPaths, find_project
from studies.results.provenance import file_digest
from studies.search_space import OF_NETWORKS, OF_PCA_GP, check_point, suggested
from studies.tracking.origin import environment
from studies.tracking.runs import SURROGATE, RunStore
from studies.tracking.sending import begin_sending, runs_sent
from studies.tracking.trial_run import TrialRun, end_run
from studies.tuning import attempts
from studies.tuning.sampler import make_pruner, sampler_of_place
from studies.tuning.storage import open_storage, study_locked
from studies.tuning.trial_training import Training, load_data, load_drive
from studies.words.quiet_loggers import working

N_KEPT = 4
"""Trials keep their weights that are among so many best ones when they end: a mean may need them."""


class TrialFailedError(Exception):
    """A configuration that cannot be trained; the study goes on without it."""


class Worker:
    """Trains trials of one study.

    Args:
        paths: the project.
        name: name of the study.
        n_threads: folds of a cross-validation that are trained at once.
    """

    def __init__(self, paths: ProjectPaths, name: str, n_threads: int = 1) -> None:
        self._paths, self._n_threads = paths, n_threads
        self._storage = open_storage(paths)
        try:
            study = optuna.load_study(study_name=name, storage=self._storage)
        except KeyError:
            raise InputError(f"there is no study {name!r}; type: studies status") from None
        self._study, self._spec = study, attempts.declaration_of(study)
        study.pruner = make_pruner(self._spec.pruner)
        self._data, self._drive = load_data(self._spec, paths), load_drive(self._spec, paths)
        self._runs = RunStore(paths)
        self._environment = environment(resolve_device(self._spec.base_config.device).type)

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

        def objective(trial: optuna.Trial) -> float:
            self._number = trial.number
            try:
                return self._train(trial, on_begun)
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

    def _train(self, trial: optuna.Trial, on_begun: Callable[[], None]) -> float:
        spec = self._spec
        trials = self._study.get_trials(deepcopy=False)
        # Another program may have taken the leased trial at that very moment.
        if not attempts.is_owned(trials[trial.number]):
            attempts.set_owner(self._storage, self._study, trial.number)
        on_begun()
        if trial.relative_params and attempts.PROPOSED_BY not in trial.user_attrs:
            trial.set_user_attr(attempts.PROPOSED_BY, spec.sampler["name"])
        try:
            check_point(spec.space, attempts.enqueued(trials[trial.number]))
            params = suggested(trial, spec.space, spec.base_config)
            config = spec.config(params)
        except (TypeError, ValueError) as error:
            # What another program has enqueued may be no value of the search space.
            trial.set_user_attr("reason", reason := f"its enqueued values are refused: {error}")
            raise TrialFailedError(reason) from error
        place = attempts.place_of(trials[trial.number], trials)
        seed = spec.trial_seed(place, 2 if spec.is_confirmation else 1)
        record = {**self._study.user_attrs.get(attempts.PROVENANCE, {}), "declaration": spec.to_dict()}
        record |= {"params": params, "seed": seed, "environment": self._environment}
        # What has an effect on this form of surrogate.
        known = OF_PCA_GP if spec.surrogate == "pca-gp" else OF_NETWORKS
        shown = {"seed": seed, **{name: getattr(config, name) for name in known}, **params}
        study_run = str(self._study.user_attrs.get(attempts.RUN_ID, ""))
        run = TrialRun(self._runs, spec, study_run, trial=trial.number, params=shown, record=record)
        trial.set_user_attr(attempts.RUN_ID, run.id)
        trial.set_user_attr(attempts.SEED, seed)
        began = time.perf_counter()
        epoch, stopped = 0, ""

        def on_epoch(report: EpochReport) -> None:
            nonlocal epoch
            run.log(report)
            epoch = report.epoch
            if spec.max_trial_s is not None and time.perf_counter() - began >= spec.max_trial_s:
                if math.isfinite(report.validation_mae):
                    trial.report(report.validation_mae, epoch)
                stop(f"reached its limit of {spec.max_trial_s:g} s at epoch {epoch}")

        def compare(step: int, value: float, is_last: bool) -> None:
            trial.report(value, step)
            # At the last step pruning saves no time, and a complete trial is evidence for the pruner.
            if not is_last and trial.should_prune():
                stop(f"pruned by {spec.pruner['name']} at epoch {epoch}")

        def stop(reason: str) -> None:
            nonlocal stopped
            stopped = reason
            raise StopTraining(reason)

        def note(reason: str, **more: Any) -> None:
            # Before the reason: whoever reads that a trial ended finds its curve complete.
            run.flush()
            trial.set_user_attr("reason", reason)
            wall_s = time.perf_counter() - began
            trial.set_user_attr("training", {"n_epochs": epoch, "wall_s": wall_s, **more})

        try:
            training = Training(spec, config, seed, self._data, self._drive)
            fitted, metrics = training.judged(on_epoch=on_epoch, on_report=compare, n_threads=self._n_threads)
            value = metrics.pop(f"{spec.chosen_by}/mae")
            n_kept = 1 if spec.folds else N_KEPT  # with folds weights cost a training of their own
            is_kept = self._n_better(value) < n_kept or spec.is_confirmation
            if fitted is None and is_kept:
                fitted = training.on_all(on_epoch=on_epoch)
        except StopTraining:  # of processes and folds, which are not judged before their end
            note(stopped)
            raise optuna.TrialPruned(stopped) from None
        except (OSError, MachineError, StorageInternalError, UpdateFinishedTrialError):
            raise  # a full disk or a database that is away is no fault of a configuration
        except Exception as error:
            # Whatever else a configuration provokes (divergence, memory) is its result.
            said = next((line.strip() for line in str(error).splitlines() if line.strip()), "")
            note(reason := f"{type(error).__name__}: {said}")
            raise TrialFailedError(reason) from error
        for name, one in metrics.items():
            trial.set_user_attr(name, one)
        if fitted is None:
            note("cross-validated", best_epoch=config.max_epochs)
            return value
        epoch = fitted.n_epochs
        if stopped:
            note(stopped, best_epoch=fitted.best_epoch)
            raise optuna.TrialPruned(stopped)
        with tempfile.TemporaryDirectory(prefix="studies-weights-") as scratch:
            folder = Path(scratch) / SURROGATE
            save_surrogate(fitted.surrogate, folder)
            weights = file_digest(folder / "weights.npz")
            if is_kept:
                self._runs.log_files(run.id, sorted(folder.iterdir()), SURROGATE)
        note(fitted.stop_reason, best_epoch=fitted.best_epoch, weights_sha256=weights)
        return value

    def _n_better(self, value: float) -> int:
        """Return how many trials that ended here are at least as good."""
        complete = self._study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        ours = (one.value for one in complete if attempts.RUN_ID in one.user_attrs)
        return sum(other is not None and other <= value for other in ours)

    def _end(self, study: optuna.Study, trial: FrozenTrial) -> None:
        run_id = trial.user_attrs.get(attempts.RUN_ID)
        if run_id:
            end_run(self._runs, run_id, trial)


def run_studies(
    paths: ProjectPaths | None, names: Sequence[str], until_s: float | None, n_threads: int = 1
) -> int:
    """Run the trials of studies; the last line of standard error says why it could not.

    Args:
        paths: the project; None for that of the working folder.
        names: names of the studies.
        until_s: no trial begins after this moment of `time.monotonic`. [s]
        n_threads: folds of a cross-validation that are trained at once.

    Returns:
        The exit code: 2 where a study cannot be used.
    """
    try:
        with working():
            project = paths or find_project(None)
            begin_sending(project)
            for name in names:
                Worker(project, name, n_threads).run(until_s=until_s)
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
