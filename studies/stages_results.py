"""What the stages left on disk, read back as the records that figures and tables are made of."""

import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulation.case import Case
from simulation.errors import InputError
from simulation.store.row_set import RowSet
from studies.paths import size_name
from studies.pipeline import Study, read_json
from studies.report.records import (
    CalibrationRecord,
    CoverageSet,
    LearningCurves,
    MeasuredSeries,
    ParameterBox,
    SensitivityRecord,
    TrialsRecord,
)
from studies.report.validation import FitRecord, PointRecord, ValidationRecord
from studies.trial_record import TrialRecord, best_record, read_history, read_records

N_COVERAGE = 256
"""Trajectories drawn of the training set, as in the paper's Fig. 4."""


@dataclass(frozen=True)
class CalibrationFiles:
    """Where a calibration lies.

    Args:
        numbers: all numbers but the trajectories, without wall times: the same again when done again.
        arrays: trajectories and histories.
    """

    numbers: Path
    arrays: Path


@dataclass(frozen=True)
class StoredCalibration:
    """A calibration as it lies on disk.

    Args:
        files: where.
        numbers: content of the JSON file.
        arrays: content of the array file.
        wall_s: how long it took. [s]
    """

    files: CalibrationFiles
    numbers: dict[str, Any]
    arrays: dict[str, NDArray[Any]]
    wall_s: float


def calibration_files(study: Study, n_train: int) -> CalibrationFiles:
    """Return the files of a calibration."""
    name = f"calibration-{size_name(n_train)}"
    return CalibrationFiles(study.results / f"{name}.json", study.results / f"{name}.npz")


def stored_calibrations(study: Study) -> Iterator[StoredCalibration]:
    """Read all calibrations of this case and measurement, smallest training set first."""
    for file in sorted(study.results.glob("calibration-n*.json")):
        numbers = read_json(file)
        manifest = read_json(study.results / f"calibrate-{file.stem.removeprefix('calibration-')}.json")
        if numbers is None or manifest is None:
            continue
        told = (numbers.get("case_sha256"), numbers.get("measurement_sha256"))
        files = calibration_files(study, int(numbers["n_train"]))
        if told == (study.case.digest, study.case.measurement.digest) and files.arrays.is_file():
            arrays = read_arrays(files.arrays)
            yield StoredCalibration(files, numbers, arrays, float(manifest["wall_s"]))


def read_arrays(file: Path) -> dict[str, NDArray[Any]]:
    """Read a calibration's array file.

    Raises:
        InputError: it is damaged.
    """
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)
    except (ValueError, EOFError, zipfile.BadZipFile, zlib.error):
        raise InputError(f"{file} is damaged; remove it and type `studies calibrate` again") from None


def measured_series(case: Case) -> MeasuredSeries:
    """Return what the case is calibrated against."""
    return MeasuredSeries(case.measurement, tuple(output.unit for output in case.outputs))


def parameter_box(case: Case) -> ParameterBox:
    """Return what is calibrated."""
    parameters = case.parameter_space.parameters
    return ParameterBox(
        names=case.parameter_space.names,
        units=tuple(parameter.unit for parameter in parameters),
        estimate=np.array([np.nan if p.estimate is None else p.estimate for p in parameters]),
        lower=case.parameter_space.lower,
        upper=case.parameter_space.upper,
        is_log=case.parameter_space.is_log,
    )


def calibration_record(stored: StoredCalibration) -> CalibrationRecord:
    """Return a calibration as a record."""
    numbers, arrays = stored.numbers, stored.arrays
    ledger, errors = numbers["ledger"], numbers["surrogate_errors"]
    return CalibrationRecord(
        n_train=numbers["n_train"],
        theta_screened=arrays["theta_screened"],
        theta_polished=arrays["theta"],
        mse_surrogate=_number(numbers["mse_surrogate"]),
        mse_screened=_number(numbers["mse_screened"]),
        mse_polished=_number(numbers["mse_polished"]),
        y_screened=arrays["y_screened"],
        y_polished=arrays["y_polished"],
        history_calls=arrays["history_calls"],
        history_mse=arrays["history_mse"],
        n_validation=ledger["n_validation"],
        n_test=ledger["n_test"],
        n_screen_checks=ledger["n_screen_checks"],
        n_polish=ledger["n_polish"],
        wall_s=stored.wall_s,
        test_mae=errors["test/mae"],
        test_p90=errors["test/p90"],
        stop_reason=numbers["polish_stop_reason"],
        surrogate=f"trial {numbers['surrogate']['trial']} of {numbers['surrogate']['study']}",
    )


def validation_record(case: Case, stored: StoredCalibration) -> ValidationRecord | None:
    """Return a calibration on the validation period, None where the case has none."""
    if case.validation is None:
        return None
    numbers, arrays = stored.numbers["validation"], stored.arrays
    measured = replace(measured_series(case), measurement=case.validation.measurement.from_first_sample)
    return ValidationRecord(
        n_train=stored.numbers["n_train"],
        period_d=case.validation.window_d,
        measurement=measured,
        y_screened=arrays["validation_y_screened"],
        y_polished=arrays["validation_y_polished"],
        points=tuple(
            PointRecord(
                name=name,
                mse_window=_unknown(point["mse_window"]),
                mse=_number(point["mse"]),
                fits=tuple(
                    FitRecord(output, **{key: _unknown(value) for key, value in fit.items()})
                    for output, fit in point["outputs"].items()
                ),
            )
            for name, point in numbers["points"].items()
        ),
    )


def sensitivity_record(study: Study) -> SensitivityRecord | None:
    """Return the Sobol indices of this case, None where there are none."""
    from studies.sensitivity import SobolIndices

    manifest, file = read_json(study.results / "sensitivity.json"), study.results / "sensitivity.npz"
    if manifest is None or manifest["inputs"]["case"] != study.case.digest or not file.is_file():
        return None
    indices = SobolIndices.load(file)
    return SensitivityRecord(
        time=indices.time,
        names=indices.names,
        output_names=indices.output_names,
        first_order=indices.first_order,
        total_order=indices.total_order,
        first_order_ci=indices.first_order_ci,
        total_order_ci=indices.total_order_ci,
        n_calls=indices.n_calls,
        model="the FMU",
    )


def coverage_set(study: Study) -> CoverageSet | None:
    """Return the first rows of the training design, None where nothing was simulated."""
    manifest = read_json(study.results / "simulate.json")
    if manifest is None or manifest["inputs"]["case"] != study.case.digest:
        return None
    file = study.paths.root / manifest["summary"]["files"]["train"]
    if not file.is_file():
        return None
    rows = RowSet.load(file).read(N_COVERAGE)
    return CoverageSet("training", rows.theta, rows.y)


def tuned_trials(study: Study) -> dict[int, tuple[Path, list[TrialRecord]]]:
    """Return, per training-set size of the last tuning, the folder of its trials and the trials."""
    manifest = read_json(study.results / "tune.json")
    found = {}
    for summary in manifest["summary"]["studies"] if manifest else []:
        name = f"{size_name(summary['n_train'])}-{summary['study'].rsplit('/', 1)[-1]}"
        folder = study.paths.mlruns / "trials" / study.label / name
        records = read_records(folder)
        if records and records[0].digests.get("case") == study.case.digest:
            found[int(summary["n_train"])] = (folder, records)
    return found


def trials_record(trials: dict[int, tuple[Path, list[TrialRecord]]]) -> TrialsRecord | None:
    """Return all trials as one record, None where there are none."""
    records = [(record, best_record(group)) for _, group in trials.values() for record in group]
    if not records:
        return None

    def metric(name: str) -> NDArray[np.float64]:
        return np.array([record.metrics.get(name, np.nan) for record, _ in records], dtype=np.float64)

    return TrialsRecord(
        n_train=np.array([record.n_train for record, _ in records], dtype=np.int64),
        state=tuple(record.state for record, _ in records),
        validation_mae=metric("val/mae"),
        test_mae=metric("test/mae"),
        test_p90=metric("test/p90"),
        is_best=np.array([record is best for record, best in records]),
    )


def learning_curves(trials: dict[int, tuple[Path, list[TrialRecord]]]) -> tuple[LearningCurves, ...]:
    """Return the learning curves of the best trial of each size."""
    curves = []
    for n_train, (folder, records) in trials.items():
        best = best_record(records)
        if best is None:
            continue
        history = read_history(folder, best.index)
        terms = [name for name in history if name not in ("epoch", "validation_mae")]
        curves.append(
            LearningCurves(
                n_train=n_train,
                epoch=history["epoch"].astype(np.int64),
                validation_mae=history["validation_mae"],
                terms=tuple((name, history[name]) for name in terms),
                best_epoch=best.best_epoch,
                stop_reason=best.reason,
            )
        )
    return tuple(curves)


def _unknown(value: float | None) -> Any:
    return float("nan") if value is None else value


def _number(value: float | None) -> float:
    return float("inf") if value is None else value
