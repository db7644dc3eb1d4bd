"""What `studies status` shows: a line per study, the trials that run, and the calibrations."""

import math
import time
from collections.abc import Sequence
from typing import Any

from studies.console import Block, Column, Said, Table, format_seconds
from studies.finished import FIRST_WORDS, Calibration, Project
from studies.report.wording import MISSING, count, difference_unit, quantity, setting, significant
from studies.tuning.results import TrialView, TunedStudy

N_BAR = 12
"""Blocks of a trial's bar."""


def status_blocks(project: Project) -> list[Block]:
    """Return what a person sees."""
    blocks: list[Block] = []
    tuned = [study for study in project.studies if not study.spec.is_baseline]
    if tuned:
        blocks += [_studies(project, tuned), Said(_total(tuned))]
    running = [
        (study, trial) for study in project.studies for trial in study.trials if trial.state == "running"
    ]
    if running:
        blocks.append(_running(running))
    if project.calibrations:
        blocks.append(calibrations_table(project.calibrations))
    return blocks or [Said(f"Nothing in {project.paths.root} yet; {FIRST_WORDS}")]


def status_document(project: Project) -> dict[str, Any]:
    """Return what a program reads."""
    return {
        "command": "status",
        "studies": [
            {
                "study": study.spec.name,
                "label": study.spec.label,
                "case": study.spec.case_name,
                "n_train": study.spec.n_train,
                "is_baseline": study.spec.is_baseline,
                "n_planned": study.n_planned,
                **{
                    f"n_{state}": study.count(state)
                    for state in ("complete", "pruned", "failed", "running", "waiting")
                },
                "n_proposed": study.n_proposed,
                "best_trial": study.best.number if study.best else None,
                "best_params": dict(study.best.params) if study.best else {},
                "best_metrics": dict(study.best.metrics) if study.best else {},
                "unit": difference_unit(study.spec.output_unit),
                "to_go_s": study.to_go_s,
            }
            for study in project.studies
        ],
        "calibrations": [calibration_values(one) for one in project.calibrations],
    }


def calibration_values(one: Calibration) -> dict[str, Any]:
    """Return a calibration as JSON values."""
    return {
        "case": one.case,
        "label": one.label,
        "name": one.name,
        "mse": one.mse if math.isfinite(one.mse) else None,
        "unit": one.unit,
        "n_calls_paper": one.ledger["total_paper"],
        "n_calls_all": one.ledger["total_honest"],
        "n_known": one.n_known,
        "changed_since": list(one.changed),
        "finished": one.finished,
    }


def _studies(project: Project, tuned: Sequence[TunedStudy]) -> Table:
    names = list(dict.fromkeys(name for study in tuned for name in study.spec.space))
    baselines = {_sets(s): s.best for s in project.studies if s.spec.is_baseline}
    units = {difference_unit(study.spec.output_unit) for study in tuned}
    alike = [(study.spec.label, study.spec.n_train) for study in tuned]
    columns = [Column("study"), Column("trials", True), Column("pruned", True, 5), Column("failed", True, 8)]
    columns += [Column("running", True, 7), *(Column(name, True, 2) for name in names)]
    columns += [Column("MAE", True), Column("P90", True), Column("PCA+GP", True, 3)]
    columns += [Column("trials/h", True, 9), Column("to go", True, 4)]
    rows = []
    for study in tuned:
        key, best = (study.spec.label, study.spec.n_train), study.best
        beside, n_failed = baselines.get(_sets(study)), study.count("failed")
        name = study.spec.name if alike.count(key) > 1 else study.spec.name.rsplit("/", 1)[0]
        n_timed = sum(trial.wall_s > 0.0 for trial in study.trials)
        left = MISSING if study.to_go_s is None else format_seconds(study.to_go_s)
        rows.append(
            [
                name,
                f"{study.n_ended}/{max(study.n_planned, len(study.trials))}",
                study.count("pruned"),
                Said(str(n_failed), "bad") if n_failed else 0,
                study.count("running"),
                *(setting(best.settings.get(one)) if best else MISSING for one in names),
                *(_error(best, one) for one in ("test/mae", "test/p90")),
                _error(beside, "test/mae"),
                f"{3600.0 * n_timed / study.wall_s:.0f}" if n_timed else MISSING,
                "done" if study.to_go_s == 0.0 else left,
            ]
        )
    unit = f", in {units.pop()}" if len(units) == 1 else ""
    title = f"Studies (errors of the best trial on the test set{unit})"
    return Table(title, columns, rows, is_dense=True)


def _sets(study: TunedStudy) -> tuple[Any, ...]:
    """Return what two studies share whose errors are compared: the label and the data."""
    return study.spec.label, study.spec.n_train, *sorted(study.spec.digests.items())


def _error(best: TrialView | None, name: str) -> str:
    return significant(best.metrics[name]) if best is not None and name in best.metrics else MISSING


def _total(tuned: Sequence[TunedStudy]) -> str:
    n_done, n_all = (
        sum(one.n_ended for one in tuned),
        sum(max(one.n_planned, len(one.trials)) for one in tuned),
    )
    parts = [f"{count(n_done)} of {count(n_all, 'trial')} done"]
    for state in ("pruned", "failed", "running", "waiting"):
        number = sum(one.count(state) for one in tuned)
        parts += [f"{count(number)} {state}"] if number else []
    parts.append(f"{format_seconds(sum(one.wall_s for one in tuned))} of training")
    return f"{count(len(tuned), 'study', 'studies')}: {', '.join(parts)}"


def _running(running: Sequence[tuple[TunedStudy, TrialView]]) -> Table:
    columns = [Column("running"), Column("epoch", True), Column("", spare=3), Column("MAE val", True)]
    columns += [Column("since", True)]
    rows = []
    for study, trial in running:
        most = study.spec.base_config.max_epochs
        full = round(N_BAR * min(trial.n_epochs / most, 1.0))
        value = trial.reports[max(trial.reports)] if trial.reports else None
        rows.append(
            [
                f"{study.spec.name} trial {trial.number}",
                f"{trial.n_epochs}/{most}",
                Said("━" * full + "─" * (N_BAR - full), "good"),
                MISSING if value is None else significant(value),
                format_seconds(max(time.time() - trial.began_s, 0.0)),
            ]
        )
    return Table("", columns, rows, is_dense=True)


def calibrations_table(calibrations: Sequence[Calibration]) -> Table:
    """Return a line per calibration, the best of each label standing out."""
    columns = [Column("calibration"), Column("final MSE", True), Column("calls (paper)", True)]
    columns += [Column("calls (all)", True, 2), Column("ended because", spare=3), Column("finished", True, 1)]
    is_any_changed = any(one.changed for one in calibrations)
    columns += [Column("changed since")] if is_any_changed else []
    least = {one.label: min(o.mse for o in calibrations if o.label == one.label) for one in calibrations}
    rows = []
    for one in calibrations:
        mse = quantity(one.mse, one.unit, 4) if math.isfinite(one.mse) else "failed"
        n_calls = one.ledger["total_paper"]
        rows.append(
            [
                one.name,
                Said(mse, "strong" if one.mse == least[one.label] and math.isfinite(one.mse) else ""),
                f"{n_calls} + {one.n_known} stored" if one.n_known else n_calls,
                one.ledger["total_honest"],
                one.reason,
                one.finished[:16].replace("T", " "),
                *([Said(", ".join(one.changed), "warn")] if is_any_changed else []),
            ]
        )
    return Table("", columns, rows, is_dense=True)
