"""Write MLflow's view of the stages that are not tuning again, from what they left on disk."""

import math
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from studies.paths import ProjectPaths
from studies.report.wording import listed
from studies.stages.pipeline import Study, read_json
from studies.tracking.tracker import metric_name

TOLD_STAGES = ("sensitivity.json", "calibrate-*.json", "uncertainty-*.json", "report.json", "paper/*.json")
"""Manifests of the stages that MLflow is told of."""

REPORT = "report"
_PAPER_FOLDER = "paper"


def stage_manifests(paths: ProjectPaths, label: str) -> list[tuple[Path, dict[str, Any]]]:
    """Return the manifests of a label's stages that MLflow is told of."""
    files = [file for pattern in TOLD_STAGES for file in sorted(paths.results(label).glob(pattern))]
    return [(file, found) for file in files if (found := read_json(file)) is not None and "digest" in found]


def stage_metrics(manifest: Mapping[str, Any]) -> dict[str, float]:
    """Return some metrics that MLflow has of a stage's result, none of a page or an item of the paper."""
    summary, kind = manifest.get("summary", {}), str(manifest.get("stage", "")).partition("-")[0]
    metrics: dict[str, float | None] = {}
    if kind == "calibrate":
        metrics = {"mse/polished": summary.get("mse_polished"), "mse/calibrated": summary.get("mse")}
    elif kind == "sensitivity":
        indices = summary.get("mean_first_order", {})
        metrics = {f"first_order/{name}": index for name, index in indices.items()}
    elif kind == "uncertainty":
        metrics = {"sample/n_effective": summary.get("sample", {}).get("n_effective")}
    return {
        metric_name(name): value
        for name, value in metrics.items()
        if value is not None and math.isfinite(value)
    }


def stage_name(paths: ProjectPaths, file: Path) -> str:
    """Return how a stage is called, from the place of its manifest below the results."""
    return file.relative_to(paths.mlruns / "results").with_suffix("").as_posix()


def write_stages(paths: ProjectPaths, label: str) -> list[str]:
    """Tell MLflow of the finished stages of a label; what it knows already stays.

    Returns:
        What could not be told, a line for each reason.
    """
    left: dict[str, list[str]] = {}
    for file, manifest in stage_manifests(paths, label):
        wall_s = float(manifest["wall_s"])
        when = {
            "started_s": datetime.fromisoformat(manifest["finished"]).timestamp() - wall_s,
            "wall_s": wall_s,
        }
        try:
            if file.parent.name == _PAPER_FOLDER:
                _write_item(paths, manifest, when)
            elif file.stem == "sensitivity":
                _write_sensitivity(paths, file, manifest, when)
            elif file.stem.startswith("uncertainty-"):
                _write_uncertainty(paths, file, manifest, when)
            elif file.stem == REPORT:
                _write_report(paths, file, manifest, when)
            else:
                _write_calibration(paths, file, manifest, when)
        except InputError as error:
            left.setdefault(str(error), []).append(stage_name(paths, file))
    return [
        f"{listed(names)} {'is' if len(names) == 1 else 'are'} not shown in MLflow: {reason}"
        for reason, names in left.items()
    ]


def _write_calibration(
    paths: ProjectPaths, file: Path, manifest: Mapping[str, Any], when: Mapping[str, float]
) -> None:
    from studies.stages.results import stored_calibrations
    from studies.stages.tracking import log_adaptive, log_calibration

    told = file.with_name(f"calibration-{file.stem.removeprefix('calibrate-')}.json")
    study = _study_of_numbers(paths, file, told, "studies calibrate")
    stored = {one.files.numbers: one for one in stored_calibrations(study)}.get(told)
    if stored is None:
        raise InputError(f"the case {study.case.name} has changed since")
    log = log_adaptive if stored.is_adaptive else log_calibration
    log(study, stored, manifest["digest"], started_s=when["started_s"], wall_s=when["wall_s"])


def _write_sensitivity(
    paths: ProjectPaths, file: Path, manifest: Mapping[str, Any], when: Mapping[str, float]
) -> None:
    from studies.stages.tracking import log_sensitivity

    recipe = manifest.get("recipe", {})
    log_sensitivity(
        _study(paths, file, recipe),
        manifest["summary"],
        manifest["digest"],
        file=_first_file(paths, manifest, "studies sensitivity"),
        recipe=recipe,
        made_with=manifest["environment"],
        **when,
    )


def _write_uncertainty(
    paths: ProjectPaths, file: Path, manifest: Mapping[str, Any], when: Mapping[str, float]
) -> None:
    from studies.stages.uncertainty_results import log_posterior, stored_posteriors

    told = file.with_name(f"posterior-{file.stem.removeprefix('uncertainty-')}.json")
    study = _study_of_numbers(paths, file, told, "studies uncertainty")
    stored = {one.files.numbers: one for one in stored_posteriors(study)}.get(told)
    if stored is None:
        raise InputError("its calibration has changed since")
    log_posterior(study, stored, manifest["digest"], started_s=when["started_s"], wall_s=when["wall_s"])


def _write_report(
    paths: ProjectPaths, file: Path, manifest: Mapping[str, Any], when: Mapping[str, float]
) -> None:
    from studies.stages.tracking import log_report

    numbers = [read_json(one) for one in sorted(file.parent.glob("calibration-*.json"))]
    cases = [one["recipe"]["case"]["name"] for one in numbers if one is not None and "recipe" in one]
    if not cases:
        raise InputError("its calibrations are gone")
    log_report(
        paths,
        file.parent.name,
        manifest["digest"],
        case={"case": cases[0], "case_sha256": manifest["inputs"]["case"]},
        note=manifest["inputs"]["note"],
        index=_first_file(paths, manifest, "studies report"),
        **when,
    )


def _write_item(paths: ProjectPaths, manifest: Mapping[str, Any], when: Mapping[str, float]) -> None:
    from studies.paper.telling import tell_item

    _first_file(paths, manifest, "studies reproduce-paper")
    files = [paths.root / name for name in manifest["files"]]
    tell_item(paths, files, manifest["digest"], case_digest=manifest["inputs"]["case"], **when)


def _study_of_numbers(paths: ProjectPaths, file: Path, told: Path, command: str) -> Study:
    """Return the study of a stage whose recipe lies with its numbers; the command makes these again."""
    numbers = read_json(told)
    if numbers is None:
        raise InputError(f"{paths.show(told)} cannot be read; type: {command}")
    return _study(paths, file, numbers.get("recipe", {}))


def _study(paths: ProjectPaths, file: Path, recipe: Mapping[str, Any]) -> Study:
    from simulation.case import load_case
    from studies.console import Console
    from studies.profile import profile_from
    from studies.recipe import checked

    recipe = checked(recipe, stage_name(paths, file))
    begin, end = recipe["window_d"]
    case = load_case(paths.root / recipe["case"]["place"], window_d=(begin, end))
    if case.digest != recipe["case"]["digest"]:
        raise InputError(f"the case {case.name} has changed since")
    return Study(
        case=case,
        profile=profile_from(recipe["profile"], file.stem),
        paths=paths,
        console=Console(quiet=True),
        n_jobs=1,
        label=file.parent.name,
        command=str(recipe["command"]),
    )


def _first_file(paths: ProjectPaths, manifest: Mapping[str, Any], command: str) -> Path:
    """Return the first of a stage's files, all of which are there."""
    files: list[Path] = [paths.root / name for name in manifest["files"]]
    lost = [paths.show(file) for file in files if not file.is_file()]
    if lost or not files:
        raise InputError(f"{', '.join(lost)} is gone; type: {command}")
    return files[0]
