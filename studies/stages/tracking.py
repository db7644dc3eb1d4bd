"""What the tracking product is told of the stages that are not tuning: numbers, curves and pictures."""

import tempfile
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from studies.paths import ProjectPaths
from studies.recipe import Recipe
from studies.report.wording import difference_unit, squared
from studies.stages.pipeline import Study, Summary
from studies.stages.results import StoredCalibration, calibration_record, measured_series, n_free_of
from studies.tracking.stage_run import StageRun, log_stage


def log_calibration(
    study: Study, stored: StoredCalibration, digest: str, *, started_s: float, wall_s: float
) -> None:
    """Tell of a finished calibration, with its figures.

    Args:
        study: the study.
        stored: what the calibration left on disk.
        digest: digest of the stage's inputs.
        started_s: start of the calibration. [s since 1970, UTC]
        wall_s: its duration. [s]
    """
    numbers, profile, n_train = stored.numbers, study.profile, stored.numbers["n_train"]
    run = StageRun(
        label=study.label,
        kind="calibration",
        name=f"{stored.name} calibration",
        key=digest,
        params={
            "n_train": n_train,
            "seed": profile.seed,
            **{f"screening.{name}": value for name, value in asdict(profile.screening).items()},
            **{f"polish.{name}": value for name, value in asdict(profile.polish).items()},
        },
        metrics={
            "mse/surrogate": numbers["mse_surrogate"],
            "mse/screened": numbers["mse_screened"],
            "mse/screening_gap": numbers["screening_gap"],
            "mse/polished": numbers["mse_polished"],
            "calls/paper": numbers["ledger"]["total_paper"],
            "calls/polish": numbers["ledger"]["n_polish"],
            **numbers["surrogate_errors"],
        },
        tags={
            "n_train": n_train,
            "surrogate_study": numbers["surrogate"]["study"],
            "surrogate_trial": numbers["surrogate"]["trial"],
        },
        started_s=started_s,
        wall_s=wall_s,
    )
    _log_with_figures(study, stored, run, point="polished")


def log_adaptive(
    study: Study, stored: StoredCalibration, digest: str, *, started_s: float, wall_s: float
) -> None:
    """Tell of a finished adaptive calibration, with its figures.

    Args:
        study: the study.
        stored: what the calibration left on disk.
        digest: digest of the stage's inputs.
        started_s: start of the calibration. [s since 1970, UTC]
        wall_s: its duration. [s]
    """
    numbers = stored.numbers
    run = StageRun(
        label=study.label,
        kind="calibration",
        name=f"{stored.name} calibration",
        key=digest,
        params={"method": "adaptive", "seed": numbers["seed"], **numbers["settings"]},
        metrics={
            "mse/calibrated": numbers["mse"],
            "calls/rounds": numbers["n_rounds"],
            **({"calls/known": numbers["n_known"]} if "n_known" in numbers else {}),
            **(
                {"calls/by_state_equations": numbers["state_equations"]["n_calls"]}
                if "state_equations" in numbers
                else {}
            ),
        },
        tags={"method": "adaptive", "stop_reason": numbers["stop_reason"]},
        started_s=started_s,
        wall_s=wall_s,
    )
    _log_with_figures(study, stored, run, point="calibrated")


def _log_with_figures(study: Study, stored: StoredCalibration, run: StageRun, *, point: str) -> None:
    """Log a calibration's run with what every calibration has: calls, validation, curve, figures, files."""
    from studies.report.figures_calibration import calibration_figure, calls_figure

    numbers = stored.numbers
    record, measured = calibration_record(stored), measured_series(study.case)
    n_free = n_free_of(numbers)
    metrics = {**run.metrics, "calls/all": numbers["ledger"]["total_honest"]}
    if "validation" in numbers:
        metrics["mse/validation"] = numbers["validation"]["points"][point]["mse"]
    curve = zip(record.history_calls.tolist(), record.history_mse.tolist(), strict=True)
    name = "convergence.png" if stored.is_adaptive else "polish.png"
    with tempfile.TemporaryDirectory(prefix="studies-figures-") as scratch:
        figures = [Path(scratch) / "calibration.png", Path(scratch) / name]
        calibration_figure(measured, record, figures[0], footnote=study.label)
        unit = squared(difference_unit(measured.units[0]))
        calls_figure(record, (), figures[1], mse_unit=unit, footnote=study.label)
        log_stage(
            study.paths,
            replace(
                run,
                metrics={key: value for key, value in metrics.items() if value is not None},
                curves={"mse/over_calls": [(int(n), mse) for n, mse in curve if np.isfinite(mse)]},
                tags={
                    "case": study.case.name,
                    "case_sha256": study.case.digest,
                    **run.tags,
                    **({} if n_free is None else {"n_free": n_free}),
                },
                figures=figures,
                artifacts=[stored.files.numbers, stored.files.arrays],
                note=study.case.note,
                record={"recipe": numbers["recipe"], "environment": numbers["environment"]},
            ),
        )


def log_sensitivity(
    study: Study,
    summary: Summary,
    digest: str,
    *,
    file: Path,
    started_s: float,
    wall_s: float,
    recipe: Recipe,
    made_with: Mapping[str, str],
) -> None:
    """Tell of finished Sobol indices.

    Args:
        study: the study.
        summary: the stage's results.
        digest: digest of the stage's inputs.
        file: the indices.
        started_s: start of the stage. [s since 1970, UTC]
        wall_s: its duration. [s]
        recipe: what rebuilds them.
        made_with: versions, machine and state of the code.
    """
    if not study.paths.tracking_database.is_file():
        study.console.say("sensitivity: making MLflow's store, once")
    shares = {f"first_order/{name}": value for name, value in summary["mean_first_order"].items()}
    shares |= {f"total_order/{name}": value for name, value in summary["mean_total_order"].items()}
    log_stage(
        study.paths,
        StageRun(
            label=study.label,
            kind="sensitivity",
            name="sensitivity",
            key=digest,
            params={"n_base": study.profile.sensitivity.n_base, "seed": study.profile.seed},
            metrics={name: value for name, value in shares.items() if value is not None},
            tags={"case": study.case.name, "case_sha256": study.case.digest},
            artifacts=[file],
            started_s=started_s,
            wall_s=wall_s,
            note=study.case.note,
            record={"recipe": recipe, "environment": dict(made_with), "numbers": summary},
        ),
    )


def log_report(
    paths: ProjectPaths,
    label: str,
    digest: str,
    *,
    case: Mapping[str, str],
    note: str,
    index: Path,
    started_s: float,
    wall_s: float,
) -> None:
    """Tell of a finished report, with all its pictures.

    Args:
        paths: the project.
        label: label of the study.
        digest: digest of the stage's inputs.
        case: name and digest of the case, as tags.
        note: the case's note.
        index: the report's page.
        started_s: start of the stage. [s since 1970, UTC]
        wall_s: its duration. [s]
    """
    log_stage(
        paths,
        StageRun(
            label=label,
            kind="report",
            name="report",
            key=digest,
            tags=case,
            figures=sorted(index.parent.glob("*.png")),
            artifacts=[index],
            started_s=started_s,
            wall_s=wall_s,
            note=note,
        ),
    )
