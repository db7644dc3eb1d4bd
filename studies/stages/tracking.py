"""What MLflow shows of the stages that are not tuning: numbers, curves and pictures."""

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from studies.report.wording import difference_unit, squared
from studies.stages.pipeline import Study, Work
from studies.stages.results import StoredResult, calibration_record, measured_series
from studies.tracking.stage_run import StageRun, log_stage


def log_calibration(study: Study, stored: StoredResult, digest: str) -> None:
    """Log a finished calibration, with its figures.

    Args:
        study: the study.
        stored: what the calibration left on disk.
        digest: digest of the stage's inputs.
    """
    from studies.report.drawing import write_png
    from studies.report.figures_calibration import calibration_figure, calls_figure

    numbers, profile, ledger = stored.numbers, study.profile, stored.numbers["ledger"]
    record, measured = calibration_record(stored), measured_series(study.case)
    if stored.is_adaptive:
        point, picture = "calibrated", "convergence.png"
        params = {"method": "adaptive", "seed": numbers["seed"], **numbers["settings"]}
        tags = {"method": "adaptive", "stop_reason": numbers["stop_reason"]}
        metrics = {
            "mse/calibrated": numbers["mse"],
            "calls/rounds": numbers["n_rounds"],
            "calls/known": numbers.get("n_known"),
            "calls/by_state_equations": numbers.get("state_equations", {}).get("n_calls"),
        }
    else:
        point, picture = "polished", "polish.png"
        params = {"n_train": record.n_train, "seed": profile.seed}
        params |= {f"screening.{name}": value for name, value in asdict(profile.screening).items()}
        params |= {f"polish.{name}": value for name, value in asdict(profile.polish).items()}
        surrogate = numbers["surrogate"]
        tags = {"n_train": record.n_train, "surrogate_study": surrogate["study"]}
        tags |= {"surrogate_trial": surrogate["trial"]}
        metrics = {
            "mse/surrogate": numbers["mse_surrogate"],
            "mse/screened": numbers["mse_screened"],
            "mse/screening_gap": numbers["screening_gap"],
            "mse/polished": numbers["mse_polished"],
            "calls/paper": ledger["total_paper"],
            "calls/polish": ledger["n_polish"],
            **numbers["surrogate_errors"],
        }
    metrics["calls/all"] = ledger["total_honest"]
    if "validation" in numbers:
        metrics["mse/validation"] = numbers["validation"]["points"][point]["mse"]
    curve = zip(record.history_calls.tolist(), record.history_mse.tolist(), strict=True)
    with tempfile.TemporaryDirectory(prefix="studies-figures-") as scratch:
        figures = [Path(scratch) / "calibration.png", Path(scratch) / picture]
        write_png(calibration_figure(measured, record), figures[0], footnote=study.label)
        unit = squared(difference_unit(measured.units[0]))
        write_png(calls_figure(record, (), mse_unit=unit), figures[1], footnote=study.label)
        _log_result(
            study,
            stored,
            digest,
            kind="calibration",
            params=params,
            metrics={key: value for key, value in metrics.items() if value is not None},
            curves={"mse/over_calls": [(int(n), mse) for n, mse in curve if np.isfinite(mse)]},
            tags=tags,
            figures=figures,
        )


def log_posterior(study: Study, stored: StoredResult, digest: str) -> None:
    """Log a finished uncertainty, with its figures.

    Args:
        study: the study.
        stored: what it left on disk.
        digest: digest of the stage's inputs.
    """
    from studies.report.drawing import write_png
    from studies.report.figures_uncertainty import band_figure, interval_figure
    from studies.report.uncertainty import uncertainty_record

    numbers = stored.numbers
    record = uncertainty_record(numbers, stored.arrays)
    known = [one["known"] for one in numbers["parameters"].values()]
    with tempfile.TemporaryDirectory(prefix="studies-figures-") as scratch:
        figures = [Path(scratch) / "bands.png", Path(scratch) / "intervals.png"]
        write_png(band_figure(measured_series(study.case), record), figures[0], footnote=study.label)
        write_png(interval_figure(study.case.parameter_space, record), figures[1], footnote=study.label)
        _log_result(
            study,
            stored,
            digest,
            kind="uncertainty",
            params={**numbers["settings"], "seed": numbers["seed"], "level": numbers["level"]},
            metrics={
                "sample/n": numbers["sample"]["n"],
                "sample/n_effective": numbers["sample"]["n_effective"],
                "calls/all": numbers["ledger"]["total"],
                "parameters/determined": known.count("determined"),
            },
            tags={"calibration": numbers["calibration"]},
            figures=figures,
        )


def _log_result(study: Study, stored: StoredResult, digest: str, *, kind: str, **more: Any) -> None:
    """Log what every stored result has, and more."""
    log_stage(
        study.paths,
        _run(
            study,
            kind,
            digest,
            name=f"{stored.name} {kind}",
            started_s=stored.started_s,
            wall_s=stored.wall_s,
            artifacts=[stored.files.numbers, stored.files.arrays],
            record={"recipe": stored.numbers["recipe"], "environment": stored.numbers["environment"]},
            **more,
        ),
    )


def log_run(work: Work, **more: Any) -> None:
    """Log the run of a stage, called as the stage, at its end.

    Args:
        work: the stage's work.
        more: what else a `StageRun` takes.
    """
    study, more = work.stage.study, {**more, "started_s": work.started_s, "wall_s": work.wall_s}
    log_stage(study.paths, _run(study, work.stage.name, work.stage.digest, name=work.stage.name, **more))


def _run(
    study: Study, kind: str, digest: str, *, name: str, tags: dict[str, Any] | None = None, **more: Any
) -> StageRun:
    about = {"case": study.case.name, "case_sha256": study.case.digest, **(tags or {})}
    return StageRun(study.label, kind, name, digest, tags=about, note=study.case.note, **more)
