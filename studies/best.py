"""What `studies best` shows: the best surrogate per training-set size, and each case's best calibration."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from studies.console import Block, Column, Said, Table
from studies.finished import FIRST_WORDS, Calibration, Project
from studies.leaderboard import leaderboard
from studies.report.wording import count, listed, percent, quantity, shown_unit
from studies.storage_url import hide_passwords
from studies.tuning.results import TunedStudy, latest_studies


def best_blocks(project: Project, sizes: Sequence[int] | None) -> list[Block]:
    """Return what a person sees."""
    blocks: list[Block] = []
    for label, found in _by_label(project, sizes).items():
        table = [one.summary(project.studies) for one in found]
        blocks.append(leaderboard(table, f"{label}: best surrogate per training-set size"))
        blocks += [Said(_worth(found)), *_how_to_load(project, found), Said("")]
    for calibration in best_calibrations(project):
        blocks += _calibration(calibration)
    return blocks or [Said(f"No completed trial and no calibration yet; {FIRST_WORDS}")]


def best_document(project: Project, sizes: Sequence[int] | None) -> dict[str, Any]:
    """Return what a program reads: where Optuna and MLflow keep everything, and the best of each size."""
    best = [one.summary(project.studies) for found in _by_label(project, sizes).values() for one in found]
    return {
        "command": "best",
        "optuna_storage": hide_passwords(project.paths.optuna_url),
        "mlflow_tracking_uri": hide_passwords(project.paths.tracking_uri),
        "sizes": [asdict(one) for one in best],
        "calibrations": [asdict(one) for one in best_calibrations(project)],
    }


def _by_label(project: Project, sizes: Sequence[int] | None) -> dict[str, list[TunedStudy]]:
    """Return the study begun last of each size that has a best trial; the label used last comes first."""
    tuned = [one for one in project.studies if not one.spec.is_baseline and one.best is not None]
    found = {}
    for label in dict.fromkeys(one.spec.label for one in sorted(tuned, key=lambda one: -one.began_s)):
        latest = latest_studies([one for one in tuned if one.spec.label == label])
        if chosen := [latest[key] for key in sorted(latest) if not sizes or key[0] in sizes]:
            found[label] = chosen
    return found


def _worth(found: Sequence[TunedStudy]) -> str:
    """Say whether tuning was worth it, against the default configuration; one seed each."""
    gains = [study.gain for study in found if study.gain is not None]
    if not gains:
        return "Whether tuning was worth it is unknown: no default configuration was trained to its end."
    spent = sum(one.wall_s for one in found)
    default_s = sum(one.default.wall_s for one in found if one.default)
    times = f", at {spent / default_s:.1f} times its training time" if default_s else ""
    n_better, mean = sum(gain > 0.0 for gain in gains), percent(sum(gains) / len(gains))
    return (
        f"Tuning beat the default configuration at {n_better} of {count(len(gains), 'size')} (one seed "
        f"each), by {mean} of its validation error on average{times}."
    )


def _how_to_load(project: Project, found: Sequence[TunedStudy]) -> list[Block]:
    spec = min(found, key=lambda study: study.best.value or math.inf if study.best else math.inf).spec
    storage, tracking = hide_passwords(project.paths.optuna_url), hide_passwords(project.paths.tracking_uri)
    lines = (
        f'  optuna.load_study(study_name="{spec.name}", storage="{storage}")',
        f'  mlflow.set_tracking_uri("{tracking}")',
        f'  mlflow.pyfunc.load_model("{spec.model_uri}").predict(theta)',
    )
    return [Said("In Python:"), Said("\n".join(lines), "dim")]


def best_calibrations(project: Project) -> list[Calibration]:
    """Return each case's calibration of least error on its latest data; one of changed files comes last."""
    by_case: dict[str, list[Calibration]] = {}
    for one in sorted(project.calibrations, key=lambda one: one.finished, reverse=True):
        same = by_case.setdefault(one.case, []) if one.mse is not None else []
        if not same or one.made_of == same[0].made_of:
            same.append(one)
    return [min(same, key=lambda one: (bool(one.changed_since), one.error)) for same in by_case.values()]


def _calibration(one: Calibration) -> list[Block]:
    how = count(one.n_calls_paper, "model call")
    how += " in the paper's count" if one.n_calls_paper != one.n_calls_all else ""
    how += f", begun with {count(one.n_known, 'stored simulation')}" if one.n_known else ""
    rows = [[k, shown_unit(one.units.get(k, "")), f"{value:.6g}"] for k, value in one.theta.items()]
    columns = [Column("parameter"), Column("unit"), Column("calibrated", True)]
    return [
        Said(f"{one.case}: best calibration: MSE {quantity(one.error, one.unit, 4)}, {how}"),
        *([Said(f"made before {listed(one.changed_since)} changed", "warn")] if one.changed_since else []),
        Table(one.name, columns, rows, is_dense=True),
    ]
