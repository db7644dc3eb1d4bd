"""What the uncertainty stage leaves on disk, read back, and told to the tracking product."""

import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from simulation.errors import InputError
from studies.report.wording import listed
from studies.stages.knowledge import is_of_this_density
from studies.stages.pipeline import Study, read_json
from studies.stages.restriction import free_space, restriction_of
from studies.stages.results import (
    ADAPTIVE,
    StoredCalibration,
    measured_series,
    most_relevant,
    n_free_of,
    read_arrays,
    stored_calibrations,
)
from studies.tracking.stage_run import StageRun, log_stage


@dataclass(frozen=True)
class PosteriorFiles:
    """Where the uncertainty of a calibration lies.

    Attributes:
        numbers: All numbers.
        arrays: Sample, particles and bands.
        rows: The stored rows that were known when it began.
    """

    numbers: Path
    arrays: Path
    rows: Path


@dataclass(frozen=True)
class StoredPosterior:
    """The uncertainty of a calibration as it lies on disk.

    Attributes:
        files: Where.
        numbers: Content of the JSON file.
        arrays: Content of the array file.
    """

    files: PosteriorFiles
    numbers: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def posterior_files(study: Study, name: str) -> PosteriorFiles:
    """Return the files of a calibration's uncertainty."""
    stem = study.results / f"posterior-{name}"
    return PosteriorFiles(
        stem.with_suffix(".json"), stem.with_suffix(".npz"), study.results / f"posterior-{name}-rows.npz"
    )


def stored_posteriors(study: Study) -> Iterator[StoredPosterior]:
    """Read what is known of the stored calibrations' uncertainty."""
    for calibration in stored_calibrations(study):
        files = posterior_files(study, calibration.name)
        numbers = read_json(files.numbers)
        manifest = read_json(study.results / f"uncertainty-{calibration.name}.json")
        if numbers is None or manifest is None or not files.arrays.is_file():
            continue
        told = (numbers["case_sha256"], numbers["measurement_sha256"], manifest["inputs"]["theta"])
        case = study.case
        space = free_space(case, restriction_of(calibration.numbers))
        is_present = told == (case.digest, case.measurement.digest, calibration.numbers["theta"])
        if is_present and is_of_this_density(manifest["inputs"], case, space):
            yield StoredPosterior(files, numbers, read_arrays(files.arrays))


def calibration_to_judge(
    study: Study, method: str | None, sizes: Sequence[int] | None, n_free: int | None = None
) -> StoredCalibration:
    """Return the calibration that was asked for: the adaptive one, else the best of the paper's.

    Args:
        study: The study.
        method: "paper" or "adaptive", None for either.
        sizes: Training-set sizes that were named, at most one; None for any.
        n_free: How many parameters it calibrated, the others fixed; None for one of all parameters.

    Raises:
        InputError: There is none.
    """
    if sizes and (method == ADAPTIVE or len(sizes) > 1):
        raise InputError("--n-train names one calibration of --method paper; give one size, or leave it away")
    stored = [one for one in stored_calibrations(study) if math.isfinite(one.mse)]
    fitting = [
        one
        for one in stored
        if (not sizes or one.numbers["n_train"] == sizes[0])
        and (method is None or one.is_adaptive == (method == ADAPTIVE))
    ]
    wanted = [one for one in fitting if n_free_of(one.numbers) == n_free]
    if wanted:
        return min(wanted, key=lambda one: (not one.is_adaptive, one.mse))
    asked = f"n_train = {sizes[0]}" if sizes else f"--method {method}" if method else "any kind"
    how = f" --n-train {sizes[0]}" if sizes else " --method paper" if method == "paper" else ""
    make = f"studies calibrate {study.command}{how}{most_relevant(n_free)}"
    if n_free is not None:
        few = [one.name for one in stored if n_free_of(one.numbers) is not None]
        there = f"there {'is' if len(few) == 1 else 'are'} {listed(few)}; " if few else ""
        raise InputError(
            f"{study.label} has no calibration of {asked} with{most_relevant(n_free)}; {there}type: {make}"
        )
    if not fitting:
        is_there = any(study.results.glob("calibration-*.json"))
        is_other = is_there and next(stored_calibrations(study), None) is None
        other = " (what is stored is of another window, measurement, scale or prior)" if is_other else ""
        raise InputError(f"{study.label} has no calibration of {asked}{other}; type: {make}")
    judge = f"studies uncertainty {study.command}{how}{most_relevant(n_free_of(fitting[0].numbers))}"
    raise InputError(
        f"{study.label} has no calibration of {asked} but {listed(one.name for one in fitting)}, which fixed "
        f"some parameters; type: {judge}, or {make} for all parameters"
    )


def log_posterior(
    study: Study, stored: StoredPosterior, digest: str, *, started_s: float, wall_s: float
) -> None:
    """Tell of a finished uncertainty, with its figures.

    Args:
        study: The study.
        stored: What it left on disk.
        digest: Digest of the stage's inputs.
        started_s: Start of the stage. [s since 1970, UTC]
        wall_s: Its duration. [s]
    """
    from studies.report.figures_uncertainty import band_figure, interval_figure
    from studies.report.uncertainty import box_of, uncertainty_record

    numbers, n_free = stored.numbers, n_free_of(stored.numbers)
    record = uncertainty_record(numbers, stored.arrays)
    with tempfile.TemporaryDirectory(prefix="studies-figures-") as scratch:
        figures = [Path(scratch) / "bands.png", Path(scratch) / "intervals.png"]
        band_figure(measured_series(study.case), record, figures[0], footnote=study.label)
        interval_figure(
            box_of(study.case.parameter_space, record.names), record, figures[1], footnote=study.label
        )
        log_stage(
            study.paths,
            StageRun(
                label=study.label,
                kind="uncertainty",
                name=f"{numbers['calibration']} uncertainty",
                key=digest,
                params={**numbers["settings"], "seed": numbers["seed"], "level": numbers["level"]},
                metrics={
                    "sample/n": numbers["sample"]["n"],
                    "sample/n_effective": numbers["sample"]["n_effective"],
                    "calls/all": numbers["ledger"]["total"],
                    "parameters/determined": sum(
                        one["known"] == "determined" for one in numbers["parameters"].values()
                    ),
                },
                tags={
                    "case": study.case.name,
                    "case_sha256": study.case.digest,
                    "calibration": numbers["calibration"],
                    **({} if n_free is None else {"n_free": n_free}),
                },
                figures=figures,
                artifacts=[stored.files.numbers, stored.files.arrays],
                started_s=started_s,
                wall_s=wall_s,
                note=study.case.note,
                record={"recipe": numbers["recipe"], "environment": numbers["environment"]},
            ),
        )
