"""Train and judge the surrogate of one trial; knows neither Optuna nor MLflow."""

import math
import re
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pelsvae.config import SurrogateConfig
from pelsvae.epochs import EpochReport, TrainingDiverged
from pelsvae.linear_network.drive import Drive
from pelsvae.metrics import errors
from pelsvae.surrogate import Surrogate
from pelsvae.training import FitResult, fit
from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.results.declaration import DRIVE, SETS, Declaration, digest_of_arrays
from studies.results.row_set import RowSet
from studies.results.saved import read_arrays

N_REPORTS = 16  # enough to stop a trial in time, and few enough to cost nothing
# Before, ranks say next to nothing: at a tenth they correlate with the end by 0.37.
PRUNE_AFTER = 0.1  # part of the epochs before trials are compared

StudyData = dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
"""The data sets of a study by name without their failed rows: pairs of theta (n, p) and y (n, t, k)."""


def load_data(spec: Declaration, paths: ProjectPaths) -> StudyData:
    """Read a study's data sets and leave out failed simulations.

    Raises:
        InputError: a set is not here, is not what the study was declared with, or has no two good rows.
    """
    data: StudyData = {}
    for name in SETS:
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


def train(
    spec: Declaration,
    config: SurrogateConfig,
    seed: int,
    data: StudyData,
    *,
    drive: Drive | None = None,
    on_epoch: Callable[[EpochReport], None],
    on_report: Callable[[int, float], None],
) -> tuple[FitResult, dict[str, float]]:
    """Train a surrogate and judge it on the validation and the test set.

    Args:
        spec: the study.
        config: settings of the surrogate.
        seed: seed of the training.
        data: the three sets.
        drive: what drives the model, for decoders that know it.
        on_epoch: called after every validated epoch; what it raises ends the training.
        on_report: called with epoch and validation error where trials are compared.

    Returns:
        The surrogate, and its errors by name (`val/mae`, `test/p90`, ...). [first output's unit]

    Raises:
        TrainingDiverged: the loss or an error is not finite.
    """
    steps = report_epochs(config.max_epochs)

    def report(now: EpochReport) -> None:
        on_epoch(now)
        # Validated epochs are coarser than the steps: of several that are due the last one counts.
        due = [step for step in steps if step <= now.epoch]
        # Of processes only the last report is of the surrogate; the others are of parts of the rows.
        if due and config.regressor == "network":
            del steps[: len(due)]
            on_report(due[-1], now.validation_mae)

    fitted = fit(
        *data["train"],
        data["validation"],
        config=config,
        seed=seed,
        log_columns=np.array(spec.is_log),
        output_scales=np.array(spec.output_scales),
        drive=drive,
        on_epoch=report,
    )
    judged = judge(fitted.surrogate, spec, data)
    # The test set is new to the training, which has seen validation errors alone.
    if not all(map(math.isfinite, judged.values())):
        raise TrainingDiverged("the errors of the trained surrogate are not finite")
    return fitted, judged


def judge(surrogate: Surrogate, spec: Declaration, data: StudyData) -> dict[str, float]:
    """Return the errors of a surrogate on the validation and the test set, by name. [output's unit]."""
    judged: dict[str, float] = {}
    for name, (theta, y) in {"val": data["validation"], "test": data["test"]}.items():
        predicted = surrogate.predict(theta)
        error = errors(predicted, y, np.array(spec.output_scales))
        judged |= {f"{name}/mae": float(error.mae), f"{name}/p90": float(error.p90)}
        if len(spec.output_names) > 1:
            by_output = np.abs(predicted - y).mean(axis=(0, 1))
            for output, mae in zip(spec.output_names, by_output, strict=True):
                allowed = re.sub(r"[^\w.-]", "_", output, flags=re.ASCII)  # in names of MLflow
                judged[f"{name}/mae_{allowed}"] = float(mae)
    return judged
