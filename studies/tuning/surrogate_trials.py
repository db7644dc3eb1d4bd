"""What a trial of a surrogate's study does: it trains one configuration, judges it and keeps its weights."""

import math
import tempfile
from pathlib import Path
from typing import Any

import optuna
from optuna.trial import TrialState

from pelsvae.device import resolve_device
from pelsvae.epochs import EpochReport, StopTraining
from pelsvae.surrogate_files import save_surrogate
from studies.own_surrogate import DESCRIPTION, OwnSurrogate
from studies.paths import ProjectPaths
from studies.results.declaration import Declaration
from studies.results.provenance import file_digest
from studies.search_space import OF_NETWORKS, OF_PCA_GP, check_point, is_own, suggested
from studies.tracking.origin import environment
from studies.tracking.runs import CURVE, SURROGATE, VALIDATION_MAE
from studies.tuning import attempts
from studies.tuning.live_trial import LiveTrial, TrialFailedError
from studies.tuning.trial_training import Training, load_data, load_drive

N_KEPT = 4
"""Trials keep their weights that are among so many best ones when they end: a mean may need them."""
N_POINTS = 100
"""Most of the loss and of each of its terms; the validation error is written at every validated epoch."""


class SurrogateTrials:
    """The objective of a study of surrogates.

    Args:
        spec: the study.
        paths: the project.
        n_threads: folds of a cross-validation that are trained at once.
    """

    def __init__(self, spec: Declaration, paths: ProjectPaths, n_threads: int) -> None:
        self._spec, self._n_threads = spec, n_threads
        self._data, self._drive = load_data(spec, paths), load_drive(spec, paths)
        self._environment = environment(resolve_device(spec.base_config.device).type)

    def __call__(self, trial: LiveTrial) -> float:
        """Train the surrogate of a trial and return the error that chooses. [output's unit]."""
        spec = self._spec
        try:
            check_point(spec.space, trial.enqueued)
            params = suggested(trial, spec.space, spec.base_config)
            config = spec.config(params)
        except (TypeError, ValueError) as error:
            # What another program has enqueued may be no value of the search space.
            raise TrialFailedError(f"its enqueued values are refused: {error}") from error
        # What has an effect on this form of surrogate.
        known = OF_PCA_GP if spec.surrogate == "pca-gp" else OF_NETWORKS
        known = config.to_dict() if is_own(spec.surrogate) else known
        shown = {"seed": trial.seed, **{name: getattr(config, name) for name in known}, **params}
        run = trial.begin(shown)
        run.write({"params": params, "seed": trial.seed, "environment": self._environment})
        trial.set_user_attr(attempts.SEED, trial.seed)
        curves = _Curves(trial)

        def compare(step: int, value: float, is_last: bool) -> None:
            trial.report(value, step)
            # At the last step pruning saves no time, and a complete trial is evidence for the pruner.
            if not is_last and trial.should_prune():
                raise StopTraining(trial.stopped)

        training = Training(spec, config, trial.seed, self._data, self._drive)
        try:
            fitted, metrics = training.judged(on_epoch=curves, on_report=compare, n_threads=self._n_threads)
            value = metrics.pop(f"{spec.chosen_by}/mae")
            n_kept = 1 if spec.folds else N_KEPT  # with folds weights cost a training of their own
            is_kept = self._n_better(trial.study, value) < n_kept or spec.is_confirmation
            if fitted is None and is_kept:
                fitted = training.on_all(on_epoch=curves)
        except StopTraining:  # of processes and folds, which are not judged before their end
            raise optuna.TrialPruned(trial.stopped) from None
        for name, one in metrics.items():
            trial.set_user_attr(name, one)
        if fitted is None:
            trial.note("cross-validated", best_epoch=config.max_epochs)
            return value
        trial.step = fitted.n_epochs
        if trial.stopped:
            trial.note(trial.stopped, best_epoch=fitted.best_epoch)
            raise optuna.TrialPruned(trial.stopped)
        with tempfile.TemporaryDirectory(prefix="studies-weights-") as scratch:
            folder = Path(scratch) / SURROGATE
            if isinstance(own := fitted.surrogate, OwnSurrogate):
                own.save(folder)
            else:
                save_surrogate(fitted.surrogate, folder)
            # A description of a user's class has the digests of its files.
            weights = file_digest(folder / (DESCRIPTION if is_own(spec.surrogate) else "weights.npz"))
            for file in sorted(folder.iterdir()) if is_kept else ():
                trial.log_file(file, SURROGATE)
        trial.note(fitted.stop_reason, best_epoch=fitted.best_epoch, weights_sha256=weights)
        return value

    def _n_better(self, study: optuna.Study, value: float) -> int:
        """Return how many trials that ended here are at least as good."""
        complete = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,))
        ours = (one.value for one in complete if attempts.RUN_ID in one.user_attrs)
        return sum(other is not None and other <= value for other in ours)


class _Curves:
    """Writes the learning curves of a trial, and ends it at its longest duration."""

    def __init__(self, trial: LiveTrial) -> None:
        self._trial, self._next_terms = trial, 1

    def __call__(self, report: EpochReport) -> None:
        seen: dict[str, Any] = {VALIDATION_MAE: report.validation_mae}
        # Validated epochs may be rarer: a multiple of both numbers would be rarer still.
        if report.epoch >= self._next_terms:
            self._next_terms = report.epoch + math.ceil(report.max_epochs / N_POINTS)
            seen |= {"loss": report.train_loss, **report.terms}
        self._trial.log({f"{CURVE}{name}": value for name, value in seen.items()}, report.epoch)
        if self._trial.is_late:
            if math.isfinite(report.validation_mae):
                self._trial.report(report.validation_mae, report.epoch)
            raise StopTraining(self._trial.stopped)
