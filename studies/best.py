"""What `studies best` shows: the best surrogate per training-set size, and each case's best calibration."""

import math
from collections.abc import Sequence
from typing import Any

from studies.console import Block, Column, Said, Table
from studies.finished import FIRST_WORDS, Calibration, Project
from studies.report.wording import (
    MISSING,
    count,
    difference_unit,
    listed,
    percent,
    quantity,
    shown_unit,
    significant,
)
from studies.status import calibration_values
from studies.storage_url import hide_passwords
from studies.tracking.registry import model_uri
from studies.tracking.study_run import shown
from studies.tuning.results import TunedStudy, importances


def best_blocks(project: Project, sizes: Sequence[int] | None) -> list[Block]:
    """Return what a person sees."""
    blocks: list[Block] = []
    for label in dict.fromkeys(one.spec.label for one in project.studies):
        found = _latest(project, label, sizes)
        if found:
            blocks += [
                _models(project, label, found),
                Said(_worth(found)),
                *_how_to_load(project, found),
                Said(""),
            ]
    for calibration in best_calibrations(project):
        blocks += _calibration(calibration)
    return blocks or [Said(f"No completed trial and no calibration yet; {FIRST_WORDS}")]


def best_document(project: Project, sizes: Sequence[int] | None) -> dict[str, Any]:
    """Return what a program reads: where Optuna and MLflow keep everything, and the best of each size."""
    labels = list(dict.fromkeys(one.spec.label for one in project.studies))
    # What was worked on last comes first: a size that two labels have stands there once for each.
    labels.sort(key=lambda label: -max(one.began_s for one in project.studies if one.spec.label == label))
    return {
        "command": "best",
        "optuna_storage": hide_passwords(project.paths.optuna_url),
        "mlflow_tracking_uri": hide_passwords(project.paths.tracking_uri),
        "sizes": [_values(project, one) for label in labels for one in _latest(project, label, sizes)],
        "calibrations": [
            {**calibration_values(one), "theta": dict(one.numbers["theta"])}
            for one in best_calibrations(project)
        ],
    }


def _latest(project: Project, label: str, sizes: Sequence[int] | None) -> list[TunedStudy]:
    """Return the study begun last of each size that has a best trial."""
    latest = {
        one.spec.n_train: one
        for one in sorted(project.studies, key=lambda one: one.began_s)
        if one.spec.label == label and not one.spec.is_baseline and one.best is not None
    }
    return [one for n, one in sorted(latest.items()) if not sizes or n in sizes]


def _values(project: Project, one: TunedStudy) -> dict[str, Any]:
    best, beside = one.best, _baseline(project, one)
    assert best is not None, "studies without a best trial are left out"
    return {
        "label": one.spec.label,
        "n_train": one.spec.n_train,
        "study": one.spec.name,
        "surrogate": one.spec.surrogate,
        "trial": best.number,
        "run_id": best.run_id,
        "model_uri": model_uri(one.spec.label, one.spec.n_train),
        "params": dict(best.params),
        "mae": best.metrics["test/mae"],
        "p90": best.metrics["test/p90"],
        "metrics": dict(best.metrics),
        "unit": difference_unit(one.spec.output_unit),
        "gain_over_default": one.gain,
        "importances": importances(one),
        "n_trials": one.n_ended,
        "n_proposed_by_sampler": one.n_proposed,
        "pca_gp": dict(beside.best.metrics) if beside and beside.best else {},
    }


def _baseline(project: Project, study: TunedStudy) -> TunedStudy | None:
    wanted = (study.spec.label, study.spec.n_train, study.spec.digests)
    alike = (one for one in project.studies if one.spec.is_baseline)
    return next((o for o in alike if (o.spec.label, o.spec.n_train, o.spec.digests) == wanted), None)


def _models(project: Project, label: str, found: Sequence[TunedStudy]) -> Table:
    names = list(dict.fromkeys(name for study in found for name in study.spec.space))
    unit = difference_unit(found[0].spec.output_unit)
    columns = [Column("n_train", True), *(Column(name, True) for name in names)]
    columns += [Column("MAE", True), Column("P90", True), Column("MAE val", True, 5), Column("tuning", True)]
    columns += [
        Column("PCA+GP MAE", True, 1),
        Column("P90", True, 3),
        Column("trials", True, 4),
        Column("trial", True, 2),
    ]
    rows = []
    for study in found:
        best, beside = study.best, _baseline(project, study)
        assert best is not None, "studies without a best trial are left out"
        gain, other = study.gain, beside.best.metrics if beside and beside.best else {}
        rows.append(
            [
                study.spec.n_train,
                *(shown(best.settings.get(name)) for name in names),
                Said(significant(best.metrics["test/mae"]), "strong"),
                significant(best.metrics["test/p90"]),
                significant(best.metrics["val/mae"]),
                MISSING if gain is None else "±0 %" if gain <= 0.0 else percent(-gain),
                *(significant(other[name]) if other else MISSING for name in ("test/mae", "test/p90")),
                study.n_ended,
                best.number,
            ]
        )
    behind = f", errors on the test set in {unit}" if unit else ", errors on the test set"
    return Table(f"{label}: best surrogate per training-set size{behind}", columns, rows, is_dense=True)


def _worth(found: Sequence[TunedStudy]) -> str:
    """Say whether tuning was worth it, against the default configuration; one seed each."""
    gains = [study.gain for study in found if study.gain is not None]
    if not gains:
        return "Whether tuning was worth it is unknown: no default configuration was trained to its end."
    spent = sum(study.wall_s for study in found)
    first = sum(study.default.wall_s for study in found if study.default)
    times = f"at {spent / first:.1f} times the training time of the default alone" if first else ""
    better = [gain for gain in gains if gain > 0.0]
    if not better:
        return f"Tuning found nothing better than the default configuration (one seed each), {times}."
    return (
        f"Tuning beat the default configuration at {len(better)} of {count(len(gains), 'size')} (one seed "
        f"each), by {percent(sum(gains) / len(gains))} of its validation error on average, {times}."
    )


def _how_to_load(project: Project, found: Sequence[TunedStudy]) -> list[Block]:
    best = min(found, key=lambda study: study.best.value if study.best and study.best.value else math.inf)
    storage, tracking = hide_passwords(project.paths.optuna_url), hide_passwords(project.paths.tracking_uri)
    return [
        Said("In Python:"),
        Said(
            f'  optuna.load_study(study_name="{best.spec.name}", storage="{storage}")\n'
            f'  mlflow.set_tracking_uri("{tracking}")\n'
            f'  mlflow.pyfunc.load_model("{model_uri(best.spec.label, best.spec.n_train)}").predict(theta)',
            "dim",
        ),
    ]


def best_calibrations(project: Project) -> list[Calibration]:
    """Return each case's calibration of least error on its latest data; one of changed files comes last."""
    by_case: dict[str, list[Calibration]] = {}
    for one in sorted(project.calibrations, key=lambda one: one.finished, reverse=True):
        if math.isfinite(one.mse):
            by_case.setdefault(one.case, []).append(one)
    return [
        min(
            (o for o in found if _target(o) == _target(found[0])),
            key=lambda one: (bool(one.changed), one.mse),
        )
        for found in by_case.values()
    ]


def _target(one: Calibration) -> tuple[Any, Any]:
    return one.numbers.get("case_sha256"), one.numbers.get("measurement_sha256")


def _calibration(one: Calibration) -> list[Block]:
    how = count(one.ledger["total_paper"], "model call")
    how += " in the paper's count" if one.ledger["total_paper"] != one.ledger["total_honest"] else ""
    how += f", begun with {count(one.n_known, 'stored simulation')}" if one.n_known else ""
    fixed = one.numbers.get("restriction", {}).get("fixed", {})
    rows = [
        [name, shown_unit(one.units.get(name, "")), f"{value:.6g}", "fixed" if name in fixed else ""]
        for name, value in one.numbers["theta"].items()
    ]
    columns = [Column("parameter"), Column("unit"), Column("calibrated", True), Column("", spare=1)]
    return [
        Said(f"{one.case}: best calibration: MSE {quantity(one.mse, one.unit, 4)}, {how}"),
        *([Said(f"made before {listed(one.changed)} changed", "warn")] if one.changed else []),
        Table(one.name, columns, rows, is_dense=True),
    ]
