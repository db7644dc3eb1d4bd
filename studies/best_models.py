"""What `studies best` shows: the best surrogate per training-set size, and each case's best calibration."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from studies.console import Block, Column, Table
from studies.project import FIRST_WORDS, FinishedCalibration, Project
from studies.report.tables import tuning_table
from studies.report.wording import count, listed, shown_unit
from studies.tuning.study_results import TunedStudy, latest_studies


def best_blocks(project: Project) -> list[Block]:
    """Return what a person sees."""
    blocks: list[Block] = []
    for label, found in best_by_label(project).items():
        table = tuning_table([one.summary(project.studies) for one in found])
        blocks += [label, *([table] if table else [])]
        blocks += [*_how_to_load(project, found), ""]
    for calibration in best_calibrations(project):
        blocks += _calibration(calibration)
    return blocks or [f"No completed trial and no calibration yet; {FIRST_WORDS}"]


def best_document(project: Project) -> dict[str, Any]:
    """Return what a program reads: where Optuna and MLflow keep everything, and the best of each size."""
    best = [one.summary(project.studies) for found in best_by_label(project).values() for one in found]
    return {
        "command": "best",
        "optuna_storage": project.paths.optuna_url,
        "mlflow_tracking_uri": project.paths.tracking_uri,
        "sizes": [asdict(one) for one in best],
        "calibrations": [one.to_dict() for one in best_calibrations(project)],
    }


def best_by_label(project: Project) -> dict[str, list[TunedStudy]]:
    """Return the study begun last of each size that has a best trial; the label used last comes first."""
    tuned = [one for one in project.studies if not one.spec.is_baseline and one.best is not None]
    found = {}
    for label in dict.fromkeys(one.spec.label for one in sorted(tuned, key=lambda one: -one.began_s)):
        latest = latest_studies([one for one in tuned if one.spec.label == label])
        found[label] = [latest[key] for key in sorted(latest)]
    return found


def _how_to_load(project: Project, found: Sequence[TunedStudy]) -> list[Block]:
    spec = min(found, key=lambda study: study.best.value or math.inf if study.best else math.inf).spec
    storage, tracking = project.paths.optuna_url, project.paths.tracking_uri
    lines = (
        f'  optuna.load_study(study_name="{spec.name}", storage="{storage}")',
        f'  mlflow.set_tracking_uri("{tracking}")',
        f'  mlflow.pyfunc.load_model("{spec.model_uri}").predict(theta)',
    )
    return ["In Python:", *lines]


def best_calibrations(project: Project) -> list[FinishedCalibration]:
    """Return each case's calibration of least error on its latest data; one of changed files comes last."""
    by_case: dict[str, list[FinishedCalibration]] = {}
    good = [one for one in project.calibrations if math.isfinite(one.found.mse)]
    for one in sorted(good, key=lambda one: one.outcome.finished, reverse=True):
        same = by_case.setdefault(one.found.case, [])
        if not same or _data(one) == _data(same[0]):
            same.append(one)
    return [min(same, key=lambda one: (bool(one.changed_since), one.found.mse)) for same in by_case.values()]


def _data(one: FinishedCalibration) -> list[object]:
    return [one.outcome.inputs.get(name) for name in ("case", "measurement")]


def _calibration(one: FinishedCalibration) -> list[Block]:
    found = one.found
    how = count(found.n_calls_paper, "model call")
    how += " in the paper's count" if found.n_calls_paper != found.n_calls else ""
    how += f", begun with {count(found.n_warm_start, 'stored simulation')}" if found.n_warm_start else ""
    rows = [[k, shown_unit(found.units.get(k, "")), f"{value:.6g}"] for k, value in found.theta.items()]
    columns = [Column("parameter"), Column("unit"), Column("calibrated", True)]
    return [
        f"{found.case}: best calibration: {found.error_name} {one.mse_text}, {how}",
        *([f"made before {listed(one.changed_since)} changed"] if one.changed_since else []),
        Table(one.name, columns, rows),
    ]
