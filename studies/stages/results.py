"""What the stages left on disk, read back as the records that figures and tables are made of."""

import math
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.errors import InputError
from simulation.whole_file import whole_file
from studies.calibration.recorder import History
from studies.paths import size_name
from studies.recipe import recipe_of
from studies.report.records import CalibrationRecord, CoverageSet, MeasuredSeries
from studies.report.validation import OutputFit, ValidatedPoint, ValidationRecord
from studies.row_set import RowSet
from studies.sensitivity import SobolIndices
from studies.stages.determined import open_in_words
from studies.stages.guided import equations_in_words
from studies.stages.knowledge import is_of_this_density, known_before
from studies.stages.pipeline import Outcome, Study, Summary, Work, read_json, write_json
from studies.tracking.origin import environment

ADAPTIVE = "adaptive"
"""What stage and files of an adaptive calibration are called."""

N_COVERAGE = 256
"""Trajectories drawn of the training set, as in the paper's Fig. 4."""

Numbers = dict[str, Any]
Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class ResultFiles:
    """Where the result of a calibration or of its uncertainty lies.

    Args:
        numbers: all numbers but the trajectories, without wall times: the same again when done again.
        arrays: trajectories, histories, samples.
    """

    numbers: Path
    arrays: Path

    @classmethod
    def of(cls, study: Study, kind: str, name: str) -> "ResultFiles":
        """Return the files of a "calibration" or a "posterior", of "adaptive" or "n0064"."""
        stem = study.results / f"{kind}-{name}"
        return cls(stem.with_suffix(".json"), stem.with_suffix(".npz"))

    @property
    def rows(self) -> Path:
        """Where it is noted which stored simulations it began with."""
        return self.numbers.with_name(f"{self.numbers.stem}-rows.npz")


@dataclass(frozen=True)
class StoredResult:
    """A calibration, or its uncertainty, as it lies on disk.

    Args:
        files: where.
        numbers: content of the JSON file.
        arrays: content of the array file.
        started_s: when it was begun. [s since 1970, UTC]
        wall_s: how long it took. [s]
    """

    files: ResultFiles
    numbers: Numbers
    arrays: Arrays
    started_s: float
    wall_s: float

    @property
    def name(self) -> str:
        """What the calibration's stage and files are called: "adaptive" or the size of the training set."""
        return self.files.numbers.stem.partition("-")[2]

    @property
    def is_adaptive(self) -> bool:
        """Whether the calibration needed no surrogate."""
        return self.name == ADAPTIVE

    @property
    def learnt_equations(self) -> bool:
        """Whether the calibration believed in state equations when it ended."""
        return bool(self.numbers.get("state_equations", {}).get("are_believed", False))

    @property
    def mse(self) -> float:
        """The calibration's final error, infinite where it failed. [first output's unit squared]."""
        return _number(self.numbers["mse" if self.is_adaptive else "mse_polished"])

    @property
    def y(self) -> FloatArray:
        """What the model answered at the calibrated parameters. Shape (t, k). [per output]."""
        return self.arrays["y" if self.is_adaptive else "y_polished"]

    def calls_to(self, target: float) -> int | None:
        """Return the calls, as the paper counts, after which the error was at most the target, or None."""
        return History(self.arrays["history_calls"], self.arrays["history_mse"]).calls_to(target)


def calibration_files(study: Study, n_train: int) -> ResultFiles:
    """Return the files of a calibration with the surrogate of a training-set size."""
    return ResultFiles.of(study, "calibration", size_name(n_train))


def keep_result(
    work: Work,
    files: ResultFiles,
    found: Numbers,
    arrays: Arrays,
    *,
    this_time: Summary,
    recipe: Mapping[str, Any],
    log: Callable[[Study, StoredResult, str], None],
    more_files: Sequence[Path] = (),
) -> Outcome:
    """Write the result of a stage into its files and MLflow, and return what the stage came to.

    Args:
        work: the stage's work, at its end.
        files: where the result goes.
        found: its numbers.
        arrays: its arrays.
        this_time: what the summary says of this time alone.
        recipe: what makes it again beyond case, profile and seed; `kind` says what it is.
        log: writes it to MLflow; called with the digest of the stage's inputs.
        more_files: files beside it without which the stage is unfinished.
    """
    study = work.stage.study
    numbers = {
        "label": study.label,
        "note": study.case.note,
        "case_sha256": study.case.digest,
        "measurement_sha256": study.case.measurement.digest,
        **found,
    }
    shown = {name: value for name, value in numbers.items() if not name.endswith("_history")}
    numbers |= {"recipe": recipe_of(study, **recipe), "environment": environment()}
    write_arrays(files.arrays, arrays)
    write_json(files.numbers, numbers)
    log(study, StoredResult(files, numbers, arrays, work.started_s, work.wall_s), work.stage.digest)
    summary = {**shown, **this_time, "file": study.paths.recorded(files.numbers)}
    return work.keep(summary, [files.numbers, files.arrays, *more_files])


def stored_calibrations(study: Study) -> Iterator[StoredResult]:
    """Read all calibrations of this case and measurement, the adaptive first, then by training set."""
    for file in sorted(study.results.glob("calibration-*.json"), key=lambda one: one.stem):
        found = stored_calibration(study, file.stem.removeprefix("calibration-"))
        if found is not None:
            yield found


def stored_calibration(study: Study, name: str) -> StoredResult | None:
    """Read one calibration of this case, measurement and density by its name, None where there is none."""
    return _stored(study, ResultFiles.of(study, "calibration", name), f"calibrate-{name}")


def stored_posteriors(study: Study) -> Iterator[StoredResult]:
    """Read what is known of the stored calibrations' uncertainty."""
    for calibration in stored_calibrations(study):
        if (found := stored_posterior(study, calibration)) is not None:
            yield found


def stored_posterior(study: Study, calibration: StoredResult) -> StoredResult | None:
    """Read what is known of a calibration's uncertainty, None where nothing is."""
    name = calibration.name
    found = _stored(study, ResultFiles.of(study, "posterior", name), f"uncertainty-{name}")
    is_of_it = found is not None and np.array_equal(found.arrays["theta"], calibration.arrays["theta"])
    return found if is_of_it else None


def _stored(study: Study, files: ResultFiles, stage: str) -> StoredResult | None:
    numbers, manifest = read_json(files.numbers), read_json(study.results / f"{stage}.json")
    if numbers is None or manifest is None or not files.arrays.is_file():
        return None
    made_of = (numbers.get("case_sha256"), numbers.get("measurement_sha256"))
    is_present = made_of == (study.case.digest, study.case.measurement.digest)
    if not is_present or not is_of_this_density(manifest["inputs"], study.case):
        return None
    return StoredResult(files, numbers, read_arrays(files.arrays), math.nan, float(manifest["wall_s"]))


def write_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write an .npz file in one step."""
    with whole_file(file) as stream:
        np.savez_compressed(stream, allow_pickle=False, **{name: np.asarray(a) for name, a in arrays.items()})


def read_arrays(file: Path) -> Arrays:
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


def calibration_record(stored: StoredResult) -> CalibrationRecord:
    """Return a calibration as a record; an adaptive one has no training set and no screened point."""
    numbers, arrays, ledger = stored.numbers, stored.arrays, stored.numbers["ledger"]
    errors, equations = numbers.get("surrogate_errors", {}), numbers.get("state_equations")
    nowhere = np.nan
    return CalibrationRecord(
        n_train=numbers["n_train"],
        theta_screened=arrays.get("theta_screened", np.full_like(arrays["theta"], nowhere)),
        theta_polished=arrays["theta"],
        mse_surrogate=_number(numbers.get("mse_surrogate", nowhere)),
        mse_screened=_number(numbers.get("mse_screened", nowhere)),
        mse_polished=stored.mse,
        y_screened=arrays.get("y_screened", np.full_like(stored.y, nowhere)),
        y_polished=stored.y,
        history_calls=arrays["history_calls"],
        history_mse=arrays["history_mse"],
        n_validation=ledger["n_validation"],
        n_test=ledger["n_test"],
        n_screen_checks=ledger["n_screen_checks"],
        n_polish=ledger["n_polish"],
        n_adaptive=ledger["n_adaptive"],
        wall_s=stored.wall_s,
        test_mae=errors.get("test/mae", nowhere),
        test_p90=errors.get("test/p90", nowhere),
        stop_reason=numbers["stop_reason" if stored.is_adaptive else "polish_stop_reason"],
        method="adaptive" if stored.is_adaptive else "paper",
        n_known=numbers.get("n_known", 0),
        knowledge=known_before(numbers),
        state_equations="" if equations is None else equations_in_words(equations),
        left_open=tuple(open_in_words(numbers)),
    )


def validation_record(case: Case, stored: StoredResult) -> ValidationRecord | None:
    """Return a calibration on the validation period, None where the case has none."""
    if case.validation is None:
        return None
    numbers, arrays = stored.numbers["validation"], stored.arrays
    last = list(numbers["points"])[-1]
    y_polished = arrays[f"validation_y_{last}"]
    measured = replace(measured_series(case), measurement=case.validation.measurement.from_first_sample)
    return ValidationRecord(
        n_train=stored.numbers["n_train"],
        period_d=case.validation.window_d,
        measurement=measured,
        y_screened=arrays.get("validation_y_screened", np.full_like(y_polished, np.nan)),
        y_polished=y_polished,
        points={
            name: ValidatedPoint(
                **point | {"outputs": {output: OutputFit(**fit) for output, fit in point["outputs"].items()}}
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
    return CoverageSet("training", RowSet.load(file).read(N_COVERAGE).y)


def _number(value: float | None) -> float:
    return float("inf") if value is None else value
