"""What `studies best` shows: the best model per size over all labels of a case, and its best calibration."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from studies.console import Block, Column, Said, Table
from studies.looking.card_stage import fixed_tables, fixed_values
from studies.looking.changed import changed_since
from studies.looking.project import Project, StageLook, StudyLook
from studies.looking.wording import error
from studies.report.wording import MISSING, count, listed, percent, quantity, setting, shown_unit, squared
from studies.stages.pipeline import read_json
from studies.tuning.trial_record import TrialRecord, trial_name

HYPERPARAMETERS = {
    "network": {
        "n_latent": Column("n_latent", True, 6),
        "n_hidden": Column("n_hidden", True, 6),
        "n_layers": Column("n_layers", True, 8),
        "beta": Column("beta", True, 7),
        "learning_rate": Column("lr", True, 7),
    },
    "gaussian-process": {"n_scales": Column("n_scales", True, 6), "degree": Column("degree", True, 6)},
}
"""By regressor: the settings that a table tells, and their columns."""


@dataclass(frozen=True)
class BestModel:
    """The best model of a size.

    Args:
        study: the study it comes from.
        trial: the trial.
        n_trials: finished trials of all studies of the size that are judged alike.
        champion: its folder as one types it in the project's root, empty where it is no champion.
    """

    study: StudyLook
    trial: TrialRecord
    n_trials: int
    champion: str

    @property
    def name(self) -> str:
        """What the trial is called on a command line."""
        return f"{self.study.called}/{trial_name(self.trial.index)}"

    @property
    def default_mae(self) -> float | None:
        """Validation error of the same study's default configuration."""
        default = self.study.default
        return default.metrics["val/mae"] if default else None

    @property
    def gain(self) -> float | None:
        """Part of the default configuration's validation error that tuning took away."""
        return 1.0 - self.trial.metrics["val/mae"] / self.default_mae if self.default_mae else None


@dataclass(frozen=True)
class Bench:
    """Models that were judged on the same data, so that their errors can be compared.

    Args:
        case_digest: sha256 of the physics.
        validation_digest: sha256 of the set that judged.
        labels: labels whose studies took part.
        models: the best one per size.
    """

    case_digest: str
    validation_digest: str
    labels: tuple[str, ...]
    models: tuple[BestModel, ...]


def benches(project: Project, labels: Sequence[str], sizes: Sequence[int] | None) -> list[Bench]:
    """Return the best models, apart for each set of data that judged them; the latest first."""
    judged: dict[tuple[str, str], list[StudyLook]] = {}
    for study in project.studies:
        if study.label in labels and study.best and (not sizes or study.n_train in sizes):
            key = (study.entry.digests.get("case", ""), study.entry.digests.get("validation", ""))
            judged.setdefault(key, []).append(study)
    latest = sorted(judged.items(), key=lambda item: -max(study.began_s for study in item[1]))
    return [
        Bench(
            *key,
            labels=tuple(sorted({study.label for study in studies})),
            models=tuple(
                _best_model(project, [study for study in studies if study.n_train == n_train])
                for n_train in sorted({study.n_train for study in studies})
            ),
        )
        for key, studies in latest
    ]


def _best_model(project: Project, studies: Sequence[StudyLook]) -> BestModel:
    found = [(study.best.metrics["val/mae"], study, study.best) for study in studies if study.best]
    _, study, trial = min(found, key=lambda item: item[0])
    folder = project.paths.champion(study.label, study.n_train)
    champion = read_json(folder / "champion.json") or {}
    is_champion = (champion.get("study"), champion.get("index")) == (study.name, trial.index)
    n_trials = sum(len(other.records) for other in studies)
    return BestModel(study, trial, n_trials, project.paths.show(folder) if is_champion else "")


def best_calibrations(project: Project, labels: Sequence[str]) -> list[StageLook]:
    """Return each case's calibration of least error on its latest data; the case calibrated last is first."""
    by_case: dict[str, list[StageLook]] = {}
    for stage in sorted(
        project.calibrations, key=lambda one: str(one.manifest.get("finished")), reverse=True
    ):
        if stage.label in labels and math.isfinite(stage.mse):
            by_case.setdefault(project.case_of(stage.label) or stage.label, []).append(stage)
    return [
        min((stage for stage in found if _target(stage) == _target(found[0])), key=lambda stage: stage.mse)
        for found in by_case.values()
    ]


def _target(stage: StageLook) -> tuple[Any, Any]:
    return stage.summary.get("case_sha256"), stage.summary.get("measurement_sha256")


def best_blocks(project: Project, labels: Sequence[str], sizes: Sequence[int] | None) -> list[Block]:
    """Return what a person sees."""
    blocks: list[Block] = []
    found = benches(project, labels, sizes)
    for place, bench in enumerate(found):
        blocks += [Said("")] if place else []
        blocks.append(_models(bench))
        blocks.append(Said(_worth(bench)))
    if len(found) > 1:
        sets = count(len(found), "validation set")
        blocks.append(Said(f"Judged on {sets}: errors of different tables are not comparable.", "warn"))
    champions = [model for model in (found[0].models if found else ()) if model.champion]
    if champions:
        blocks += _how_to_load(min(champions, key=lambda model: model.trial.metrics["val/mae"]))
    for calibration in best_calibrations(project, labels):
        blocks += _calibration(project, calibration)
    return blocks


def best_document(project: Project, labels: Sequence[str], sizes: Sequence[int] | None) -> dict[str, Any]:
    """Return what a program reads."""
    return {
        "command": "best",
        "labels": list(labels),
        "benches": [
            {
                "case_sha256": bench.case_digest,
                "validation_sha256": bench.validation_digest,
                "labels": list(bench.labels),
                "models": [
                    {
                        "n_train": model.study.n_train,
                        "trial": model.name,
                        "study": model.study.name,
                        "index": model.trial.index,
                        "metrics": dict(model.trial.metrics),
                        "unit": model.study.unit,
                        "config": model.trial.config,
                        "params": model.trial.params,
                        "n_trials": model.n_trials,
                        "default_mae": model.default_mae,
                        "gain": model.gain,
                        "champion": model.champion or None,
                    }
                    for model in bench.models
                ],
            }
            for bench in benches(project, labels, sizes)
        ],
        "calibrations": [
            {
                "case": project.case_of(calibration.label),
                "name": calibration.name,
                "mse": calibration.mse,
                "unit": squared(project.unit_of(calibration.label)),
                "n_calls_paper": calibration.n_calls,
                "n_known": calibration.n_known,
                "changed_since": list(changed_since(project, calibration)),
                "theta": dict(calibration.summary["theta"]),
                "fixed": fixed_values(calibration),
            }
            for calibration in best_calibrations(project, labels)
        ],
    }


def _models(bench: Bench) -> Table:
    unit = next((model.study.unit for model in bench.models), "")
    present = {_regressor(model.trial.config) for model in bench.models}
    shown = {regressor: names for regressor, names in HYPERPARAMETERS.items() if regressor in present}
    columns = [
        Column("n_train", True),
        Column("MAE val", True),
        Column("P90 val", True, 5),
        Column("MAE test", True),
        Column("P90 test", True, 2),
        Column("default", True, 3),
        Column("tuning", True),
        *(column for names in shown.values() for column in names.values()),
        Column("trials", True, 4),
        Column("trial"),
    ]
    rows = []
    for model in bench.models:
        metrics, config = model.trial.metrics, model.trial.config
        gain = model.gain
        rows.append(
            [
                model.study.n_train,
                Said(error(metrics["val/mae"]), "strong"),
                *(error(metrics.get(name)) for name in ("val/p90", "test/mae", "test/p90")),
                error(model.default_mae),
                MISSING if gain is None else "±0 %" if gain <= 0.0 else percent(-gain),
                *(
                    setting(config.get(name)) if _regressor(config) == regressor else MISSING
                    for regressor, names in shown.items()
                    for name in names
                ),
                model.n_trials,
                Said(model.name, "good" if model.champion else ""),
            ]
        )
    behind = f" (errors in {unit})" if unit else ""
    return Table(f"{', '.join(bench.labels)}: best model per size{behind}", columns, rows, is_dense=True)


def _regressor(config: Mapping[str, Any]) -> str:
    """Return the form of a trial's surrogate; trials of earlier versions were all of networks."""
    return str(config.get("regressor", "network"))


def _worth(bench: Bench) -> str:
    """Say whether tuning was worth it, against the default configuration."""
    gains = [model.gain for model in bench.models if model.gain is not None]
    if not gains:
        return "Whether tuning was worth it cannot be told: no default configuration (trial 0) was completed."
    spent = sum(record.wall_s for model in bench.models for record in model.study.records)
    first = sum(model.study.default.wall_s for model in bench.models if model.study.default)
    better = [gain for gain in gains if gain > 0.0]
    times = f"at {spent / first:.1f} times the training time of the default alone" if first else ""
    if not better:
        return f"Tuning found nothing better than the default configuration (trial 0), {times}."
    mean = percent(sum(gains) / len(gains))
    return (
        f"Tuning beat the default configuration (trial 0) at {len(better)} of "
        f"{count(len(gains), 'size')}, by {mean} of its validation error on average, {times}."
    )


def _how_to_load(model: BestModel) -> list[Block]:
    folder = model.champion
    return [
        Said(f"\nThe best of them is the champion in {folder}; in Python, from the project's root:"),
        Said(
            "  from pathlib import Path; from studies.tuning.champion import load_champion\n"
            f'  surrogate, info = load_champion(Path("{folder}"))\n'
            "  y = surrogate.predict(theta)  # rows of parameters, ordered as info.parameter_names",
            "strong",
        ),
    ]


def _calibration(project: Project, stage: StageLook) -> list[Block]:
    unit = squared(project.unit_of(stage.label))
    how = count(stage.n_calls, "model call") + (" in the paper's count" if stage.has_paper_count else "")
    if stage.n_known:
        how += f", begun with {count(stage.n_known, 'stored simulation')}"
    changed = listed(changed_since(project, stage))
    theta = stage.summary["theta"]
    rows = [
        [name, shown_unit(stage.units.get(name, "")), f"{value:.6g}"]
        for name, value in theta.items()
        if name not in stage.fixed
    ]
    columns = [Column("parameter"), Column("unit"), Column("calibrated", True)]
    return [
        Said(
            f"\n{project.case_of(stage.label) or stage.label}: best calibration: "
            f"MSE {quantity(stage.mse, unit, 4)}, {how}"
        ),
        *([Said(f"made before {changed} changed", "warn")] if changed else []),
        Table(stage.name, columns, rows, is_dense=True),
        *fixed_tables(stage),
    ]
