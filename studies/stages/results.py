"""What the stages left on disk, read back as the records that figures and tables are made of."""

import zipfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulation.case import Case
from simulation.errors import InputError
from studies.paths import size_name
from studies.report.records import CalibrationRecord, CoverageSet, MeasuredSeries
from studies.report.restricted import restriction_record
from studies.report.validation import OutputFit, ValidatedPoint, ValidationRecord
from studies.row_set import RowSet
from studies.sensitivity import SobolIndices
from studies.stages.determined import open_in_words
from studies.stages.guided import equations_in_words
from studies.stages.knowledge import is_of_this_density, known_before
from studies.stages.pipeline import Study, read_json

ADAPTIVE = "adaptive"
"""What stage and files of an adaptive calibration are called."""

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

    @property
    def rows(self) -> Path:
        """Where it is noted which stored simulations it began with."""
        return self.numbers.with_name(f"{self.numbers.stem}-rows.npz")


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

    @property
    def name(self) -> str:
        """What its stage and files are called: "adaptive" or the size of the training set."""
        return self.files.numbers.stem.removeprefix("calibration-")

    @property
    def is_adaptive(self) -> bool:
        """Whether it needed no surrogate."""
        return bool(self.numbers.get("method") == ADAPTIVE)

    @property
    def learnt_equations(self) -> bool:
        """Whether it believed in state equations when it ended."""
        return bool(self.numbers.get("state_equations", {}).get("are_believed", False))

    @property
    def mse(self) -> float:
        """Its final error, infinite where it failed. [first output's unit squared]."""
        return _number(self.numbers["mse" if self.is_adaptive else "mse_polished"])

    @property
    def point(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The calibrated parameters, shape (p,), and what the model answered there, shape (t, k)."""
        return self.arrays["theta"], self.arrays["y" if self.is_adaptive else "y_polished"]


def calibration_files(study: Study, n_train: int, n_free: int | None = None) -> CalibrationFiles:
    """Return the files of a calibration, of the `n_free` most relevant parameters or of all."""
    return _files(study, size_name(n_train) + restricted(n_free))


def adaptive_files(study: Study, n_free: int | None = None) -> CalibrationFiles:
    """Return the files of the adaptive calibration, of the `n_free` most relevant parameters or of all."""
    return _files(study, ADAPTIVE + restricted(n_free))


def restricted(n_free: int | None) -> str:
    """Return what the names of a restricted calibration end with, "" for one of all parameters."""
    return "" if n_free is None else f"-relevant{n_free}"


def most_relevant(n_free: int | None) -> str:
    """Return the words by which a command means a restricted calibration, "" for one of all parameters."""
    return "" if n_free is None else f" --most-relevant {n_free}"


def n_free_of(numbers: Mapping[str, Any]) -> int | None:
    """Return how many parameters a calibration was restricted to, None for all."""
    return numbers["restriction"]["n_free"] if "restriction" in numbers else None


def _files(study: Study, name: str) -> CalibrationFiles:
    stem = study.results / f"calibration-{name}"
    return CalibrationFiles(stem.with_suffix(".json"), stem.with_suffix(".npz"))


def stored_calibrations(study: Study) -> Iterator[StoredCalibration]:
    """Read all calibrations of this case and measurement, the adaptive first, then by training set."""
    for file in sorted(study.results.glob("calibration-*.json"), key=lambda one: one.stem):
        found = stored_calibration(study, file.stem.removeprefix("calibration-"))
        if found is not None:
            yield found


def stored_calibration(study: Study, name: str) -> StoredCalibration | None:
    """Read one calibration of this case, measurement and density by its name, None where there is none."""
    files = _files(study, name)
    numbers, manifest = read_json(files.numbers), read_json(study.results / f"calibrate-{name}.json")
    if numbers is None or manifest is None or not files.arrays.is_file():
        return None
    if (numbers.get("case_sha256"), numbers.get("measurement_sha256")) != (
        study.case.digest,
        study.case.measurement.digest,
    ) or not is_of_this_density(manifest["inputs"], study.case):
        return None
    return StoredCalibration(files, numbers, read_arrays(files.arrays), float(manifest["wall_s"]))


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


def calibration_record(stored: StoredCalibration) -> CalibrationRecord:
    """Return a calibration as a record."""
    record = _adaptive_record(stored) if stored.is_adaptive else _polished_record(stored)
    numbers = stored.numbers
    told = numbers.get("state_equations")
    return replace(
        record,
        restriction=restriction_record(numbers),
        knowledge=known_before(numbers),
        state_equations="" if told is None else equations_in_words(told),
        left_open=tuple(open_in_words(numbers)),
    )


def _polished_record(stored: StoredCalibration) -> CalibrationRecord:
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


def _adaptive_record(stored: StoredCalibration) -> CalibrationRecord:
    numbers, arrays = stored.numbers, stored.arrays
    nowhere = float("nan")
    return CalibrationRecord(
        n_train=0,
        theta_screened=np.full_like(arrays["theta"], nowhere),
        theta_polished=arrays["theta"],
        mse_surrogate=nowhere,
        mse_screened=nowhere,
        mse_polished=numbers["mse"],
        y_screened=np.full_like(arrays["y"], nowhere),
        y_polished=arrays["y"],
        history_calls=arrays["history_calls"],
        history_mse=arrays["history_mse"],
        n_validation=0,
        n_test=0,
        n_screen_checks=0,
        n_polish=0,
        wall_s=stored.wall_s,
        stop_reason=numbers["stop_reason"],
        method="adaptive",
        n_adaptive=numbers["ledger"]["n_adaptive"],
        n_known=numbers.get("n_known", 0),
    )


def validation_record(case: Case, stored: StoredCalibration) -> ValidationRecord | None:
    """Return a calibration on the validation period, None where the case has none."""
    if case.validation is None:
        return None
    numbers, arrays = stored.numbers["validation"], stored.arrays
    last = list(numbers["points"])[-1]
    y_polished = arrays[f"validation_y_{last}"]
    measured = replace(measured_series(case), measurement=case.validation.measurement.from_first_sample)
    return ValidationRecord(
        n_train=stored.numbers["n_train"],
        n_free=n_free_of(stored.numbers),
        period_d=case.validation.window_d,
        measurement=measured,
        y_screened=arrays.get("validation_y_screened", np.full_like(y_polished, np.nan)),
        y_polished=y_polished,
        points={
            name: ValidatedPoint(
                mse_window=point["mse_window"],
                mse=point["mse"],
                failure=point["failure"],
                outputs={output: OutputFit(**fit) for output, fit in point["outputs"].items()},
            )
            for name, point in numbers["points"].items()
        },
    )


def stored_indices(study: Study) -> SobolIndices | None:
    """Return the Sobol indices of this case, None where there are none."""
    manifest, file = read_json(study.results / "sensitivity.json"), study.results / "sensitivity.npz"
    if manifest is None or manifest["inputs"]["case"] != study.case.digest or not file.is_file():
        return None
    return SobolIndices.load(file)


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


def _number(value: float | None) -> float:
    return float("inf") if value is None else value
