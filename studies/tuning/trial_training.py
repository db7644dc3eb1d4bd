"""Train and judge the surrogate of one trial; knows neither Optuna nor MLflow."""

import math
import re
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, replace
from queue import SimpleQueue
from threading import Event
from typing import cast

import numpy as np
from numpy.typing import NDArray

from pelsvae.config import SurrogateConfig
from pelsvae.device import n_threads_set
from pelsvae.epochs import EpochReport, StopTraining, TrainingDiverged
from pelsvae.linear_network.drive import Drive
from pelsvae.metrics import errors
from pelsvae.training import FitResult, fit
from simulation.errors import InputError
from studies.own_surrogate import fit_own
from studies.paths import ProjectPaths
from studies.results.declaration import (
    CROSS_VALIDATED,
    DRIVE,
    UNEXPLAINED,
    Declaration,
    digest_of_arrays,
)
from studies.results.row_set import RowSet
from studies.results.saved import read_arrays
from studies.search_space import OwnConfig

N_REPORTS = 16  # enough to stop a trial in time, and few enough to cost nothing
# Before, ranks say next to nothing: at a tenth they correlate with the end by 0.37.
PRUNE_AFTER = 0.1  # part of the epochs before trials are compared

OnEpoch = Callable[[EpochReport], None]
OnReport = Callable[[int, float, bool], None]
StudyData = dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
"""The data sets of a study by name without their failed rows: pairs of theta (n, p) and y (n, t, k)."""


def load_data(spec: Declaration, paths: ProjectPaths) -> StudyData:
    """Read a study's data sets and leave out failed simulations.

    Raises:
        InputError: a set is not here, is not what the study was declared with, or has no two good rows.
    """
    data: StudyData = {}
    for name in spec.sets:
        file = spec.file(paths, name)
        rows = RowSet.load(file).read(spec.n_train if name == "train" else None)
        # Errors on other rows would stand beside each other as if they compared.
        if rows.digest != spec.digests[name]:
            raise InputError(f"{file} has changed since the study was declared; type: studies tune")
        good = rows.take(~rows.failed)
        if good.n < 2:
            raise InputError(f"{file}: {good.n} of {rows.n} simulations did not fail; at least 2 are needed")
        data[name] = good.theta, good.y
    return data


def load_drive(spec: Declaration, paths: ProjectPaths) -> Drive | None:
    """Read what drives a study's model; None where no decoder needs it.

    Raises:
        InputError: the file is not here, or not the one that the study was declared with.
    """
    if DRIVE not in spec.files:
        return None
    file = spec.file(paths, DRIVE)
    if not file.is_file():
        raise InputError(f"{file}: no such file; type: studies tune")
    arrays = read_arrays(file)
    if digest_of_arrays(arrays) != spec.digests[DRIVE]:
        raise InputError(f"{file} has changed since the study was declared; type: studies tune")
    return Drive.from_arrays(arrays)


def report_epochs(max_epochs: int) -> list[int]:
    """Return the epochs at which trials are compared: a geometric row, dense where most trials stop."""
    row = np.geomspace(max(1.0, PRUNE_AFTER * max_epochs), max_epochs, N_REPORTS)
    return sorted({round(epoch) for epoch in row})


@dataclass(frozen=True)
class Training:
    """The training of one configuration.

    Attributes:
        spec: the study.
        config: settings of the surrogate.
        seed: seed of the training.
        data: the sets.
        drive: what drives the model, for decoders that know it.
    """

    spec: Declaration
    config: SurrogateConfig | OwnConfig
    seed: int
    data: StudyData
    drive: Drive | None = None

    def judged(
        self,
        *,
        on_epoch: OnEpoch = lambda now: None,
        on_report: OnReport = lambda step, error, is_last: None,
        n_threads: int = 1,
    ) -> tuple[FitResult | None, dict[str, float]]:
        """Train a surrogate and judge it on the validation and the test set, or by cross-validation.

        Args:
            on_epoch: called after every reported epoch; what it raises ends the training.
            on_report: called with the step (epoch, or number of folds), the error there, and whether it is
                the last step, where trials are compared.
            n_threads: folds that are trained at once; decides no digit.

        Returns:
            The surrogate, None after cross-validation (see `on_all`); and its errors by name (`val/mae`,
            `test/p90`, ..., or `cv/mae`, ...). [first output's unit]

        Raises:
            TrainingDiverged: the loss or an error is not finite.
        """
        if self.spec.folds:
            return None, _finite(self._cross_validated(on_epoch, on_report, n_threads))
        steps = report_epochs(self.config.max_epochs)

        def report(now: EpochReport) -> None:
            on_epoch(now)
            # Validated epochs are coarser than the steps: of several that are due the last one counts.
            due = [step for step in steps if step <= now.epoch]
            # Of processes only the last report is of the surrogate; the others are of parts of the rows.
            if due and self.config.regressor == "network":
                del steps[: len(due)]
                on_report(due[-1], now.validation_mae, due[-1] == self.config.max_epochs)

        fitted = self._fit(self.data["train"], self.data["validation"], report)
        judged: dict[str, float] = {}
        for name, (theta, y) in {"val": self.data["validation"], "test": self.data["test"]}.items():
            judged |= errors_by_name(name, fitted.surrogate.predict(theta), y, self.spec)
        return fitted, _finite(judged)

    def on_all(self, *, on_epoch: OnEpoch) -> FitResult:
        """Train a surrogate that was cross-validated, with all training rows, to the last epoch.

        Args:
            on_epoch: as of `judged`.

        Raises:
            TrainingDiverged: the loss is not finite.
        """
        before = len(self._folds()) * self.config.max_epochs
        return self._fit(self.data["train"], None, lambda now: on_epoch(_after(now, before)))

    def _folds(self) -> list[NDArray[np.bool_]]:
        """Return which rows each fold holds out; rows of a design are in random order already."""
        n = len(self.data["train"][0])
        n_folds = min(self.spec.folds, n)
        return [np.arange(n) % n_folds == number for number in range(n_folds)]

    def _cross_validated(self, on_epoch: OnEpoch, on_report: OnReport, n_threads: int) -> dict[str, float]:
        """Return the errors of all training rows, each by a surrogate of the other folds. [output's unit]."""
        _, y = self.data["train"]
        folds, max_epochs = self._folds(), self.config.max_epochs
        predicted, done = np.empty_like(y), np.zeros(len(y), dtype=bool)
        judged: dict[str, float] = {}
        # The same folds for every trial.
        with closing(self._trained_folds(folds, on_epoch, n_threads)) as trained:
            for number, (held, of_held) in enumerate(zip(folds, trained, strict=True), start=1):
                predicted[held], done = of_held, done | held
                judged = errors_by_name(CROSS_VALIDATED, predicted[done], y[done], self.spec)
                mae = judged[f"{CROSS_VALIDATED}/mae"]
                on_epoch(EpochReport(number * max_epochs, len(folds) * max_epochs, math.nan, mae))
                on_report(number, mae, number == len(folds))
        return judged

    def _trained_folds(
        self, folds: Sequence[NDArray[np.bool_]], on_epoch: OnEpoch, n_threads: int
    ) -> Generator[NDArray[np.float64]]:
        """Yield the predictions of each fold's rows; folds are reported in their order and in this thread.

        The kernels let other threads run, so folds side by side take less time. What `on_epoch` raises ends
        all of them.
        """
        theta, y = self.data["train"]
        reports = [SimpleQueue[EpochReport | None]() for _ in folds]
        is_over = Event()

        def fitted(number: int) -> FitResult:
            def report(now: EpochReport) -> None:
                if is_over.is_set():
                    raise StopTraining("the trial has ended")
                reports[number].put(now)

            try:
                # The held-out rows choose no epoch: what they judge has not seen them.
                others = ~folds[number]
                return self._fit((theta[others], y[others]), None, report)
            finally:
                reports[number].put(None)

        with n_threads_set(self.config.n_threads), ThreadPoolExecutor(n_threads) as pool:
            results = [pool.submit(fitted, number) for number in range(len(folds))]
            try:
                for number, (held, result) in enumerate(zip(folds, results, strict=True)):
                    for now in iter(reports[number].get, None):
                        on_epoch(_after(now, number * self.config.max_epochs))
                    yield result.result().surrogate.predict(theta[held])
            finally:
                is_over.set()
                for result in results:
                    result.cancel()

    def _fit(
        self,
        rows: tuple[NDArray[np.float64], NDArray[np.float64]],
        validation: tuple[NDArray[np.float64], NDArray[np.float64]] | None,
        on_epoch: OnEpoch,
    ) -> FitResult:
        if isinstance(own := self.config, OwnConfig):
            fitted = fit_own(
                rows,
                validation,
                config=own,
                seed=self.seed,
                log_columns=np.array(self.spec.is_log),
                output_scales=np.array(self.spec.output_scales),
                on_epoch=on_epoch,
            )
            return cast("FitResult", fitted)
        return fit(
            *rows,
            validation,
            config=self.config,
            seed=self.seed,
            log_columns=np.array(self.spec.is_log),
            output_scales=np.array(self.spec.output_scales),
            drive=self.drive,
            on_epoch=on_epoch,
        )


def _after(now: EpochReport, before: int) -> EpochReport:
    """Return a report of one of several trainings, counted from the begin of the first."""
    return replace(now, epoch=before + now.epoch, max_epochs=before + now.max_epochs)


def errors_by_name(
    name: str, predicted: NDArray[np.float64], y: NDArray[np.float64], spec: Declaration
) -> dict[str, float]:
    """Return the errors of predictions (n, t, k), their names beginning with `name`. [output's unit]."""
    error = errors(predicted, y, np.array(spec.output_scales))
    scales = np.array(spec.output_scales)
    left, varies = (float(np.square(one * scales).sum()) for one in (predicted - y, y - y.mean(axis=0)))
    judged = {f"{name}/mae": float(error.mae), f"{name}/p90": float(error.p90)}
    # Part of the variance that is not explained.
    judged[f"{name}{UNEXPLAINED}"] = left / varies if varies > 0.0 else 1.0
    if len(spec.output_names) > 1:
        by_output = np.abs(predicted - y).mean(axis=(0, 1))
        for output, mae in zip(spec.output_names, by_output, strict=True):
            allowed = re.sub(r"[^\w.-]", "_", output, flags=re.ASCII)  # in names of MLflow
            judged[f"{name}/mae_{allowed}"] = float(mae)
    return judged


def _finite(judged: dict[str, float]) -> dict[str, float]:
    """Return errors that are finite: rows that judge are new to the training."""
    if not all(map(math.isfinite, judged.values())):
        raise TrainingDiverged("the errors of the trained surrogate are not finite")
    return judged
