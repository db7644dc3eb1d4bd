"""What `studies status` shows: a line per study, what runs at this moment, and the calibrations."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from studies.console import Block, Column, Said, Table, Tone, format_seconds
from studies.looking.changed import changed_since
from studies.looking.names import chosen_labels
from studies.looking.pace import Pace, pace_of
from studies.looking.project import Project, StageLook, StudyLook
from studies.looking.wording import ago, error
from studies.report.wording import MISSING, count, quantity, squared
from studies.tuning.trial_record import trial_name

FIRST_WORDS = "type: studies run (the office, some minutes), or studies new for a case of your own"
N_BAR = 12
"""Blocks of a trial's bar."""
_TONES: dict[str, Tone] = {"finished": "", "running": "good", "waiting": "dim", "stopped": "warn"}


@dataclass(frozen=True)
class StudyLine:
    """A study and how it gets on."""

    study: StudyLook
    pace: Pace


def status_blocks(project: Project, which: str | None) -> list[Block]:
    """Return what a person sees."""
    labels = chosen_labels(project, which)
    if not labels:
        return [Said(f"Nothing in {project.paths.root} yet; {FIRST_WORDS}")]
    lines = study_lines(project, labels)
    calibrations = [stage for stage in project.calibrations if stage.label in labels]
    blocks: list[Block] = []
    if lines:
        blocks += [studies_table(lines), Said(_total(lines))]
    running = [line for line in lines if line.study.running or line.study.lost]
    if running:
        blocks.append(_running(running))
    if calibrations:
        blocks.append(calibrations_table(project, calibrations))
    if not blocks:
        blocks = [Said(f"{', '.join(labels)}: no trials and no calibrations yet; type: studies tune")]
    return blocks


def status_document(project: Project, which: str | None) -> dict[str, Any]:
    """Return what a program reads."""
    labels = chosen_labels(project, which)
    lines = study_lines(project, labels)
    return {
        "command": "status",
        "studies": [_study_values(line) for line in lines],
        "running": [
            {"study": line.study.name, "is_lost": trial in line.study.lost, **asdict(trial)}
            for line in lines
            for trial in (*line.study.running, *line.study.lost)
        ],
        "calibrations": [
            {
                "label": stage.label,
                "name": stage.name,
                "mse": stage.mse if math.isfinite(stage.mse) else None,
                "n_calls_paper": stage.n_calls,
                "n_calls_all": stage.summary["ledger"]["total_honest"],
                "n_known": stage.n_known,
                "changed_since": list(changed_since(project, stage)),
                "finished": stage.manifest.get("finished"),
            }
            for stage in project.calibrations
            if stage.label in labels
        ],
    }


def study_lines(project: Project, labels: Sequence[str]) -> list[StudyLine]:
    """Return the studies of some labels with how they get on."""
    busy = {study.label for study in project.studies if study.running}
    return [
        StudyLine(study, pace_of(study, is_label_running=study.label in busy))
        for study in project.studies
        if study.label in labels
    ]


def _study_values(line: StudyLine) -> dict[str, Any]:
    study, best = line.study, line.study.best
    return {
        "study": study.name,
        "label": study.label,
        "case": study.entry.case_name,
        "n_train": study.n_train,
        "n_planned": study.n_planned,
        "n_done": len(study.records),
        "n_complete": study.count("complete"),
        "n_pruned": study.count("pruned"),
        "n_failed": study.count("failed"),
        "n_running": len(study.running),
        "best_trial": best.index if best else None,
        "best_metrics": dict(best.metrics) if best else {},
        "unit": study.unit,
        **asdict(line.pace),
    }


def studies_table(lines: Sequence[StudyLine]) -> Table:
    """Return a line per study."""
    units = {line.study.unit for line in lines if line.study.unit}
    title = f"Studies (errors in {units.pop()})" if len(units) == 1 else "Studies"
    columns = [
        Column("study"),
        Column("trials", True),
        Column("pruned", True),
        Column("failed", True, 0 if any(line.study.count("failed") for line in lines) else 9),
        Column("running", True, 4),
        Column("MAE val", True),
        Column("P90 val", True, 5),
        Column("MAE test", True),
        Column("P90 test", True, 3),
        Column("trials/h", True, 6),
        Column("to go", True),
        Column("host", spare=8),
        Column("last sign", True, 7),
    ]
    rows = []
    for line in lines:
        study, pace, best = line.study, line.pace, line.study.best
        metrics = best.metrics if best else {}
        n_failed, n_running = study.count("failed"), len(study.running)
        rows.append(
            [
                Said(study.called, _TONES[pace.mood]),
                f"{len(study.records)}/{study.n_planned}",
                _quiet_zero(study.count("pruned")),
                Said(str(n_failed), "bad") if n_failed else _quiet_zero(0),
                Said(str(n_running), "good") if n_running else _quiet_zero(0),
                *(error(metrics.get(name)) for name in ("val/mae", "val/p90", "test/mae", "test/p90")),
                _rate(pace.trials_per_h),
                _to_go(pace),
                pace.host,
                ago(pace.heard_s),
            ]
        )
    return Table(title, columns, rows, is_dense=True)


def _quiet_zero(number: int) -> Said:
    return Said(str(number), "" if number else "dim")


def _rate(trials_per_h: float | None) -> str:
    if trials_per_h is None:
        return MISSING
    return f"{trials_per_h:.1f}" if trials_per_h < 99.95 else count(trials_per_h)


def _to_go(pace: Pace) -> Said:
    if pace.mood == "finished":
        return Said("done", "dim")
    if pace.mood == "running":
        return Said(MISSING if pace.to_go_s is None else format_seconds(pace.to_go_s))
    return Said(pace.mood, _TONES[pace.mood])


def _total(lines: Sequence[StudyLine]) -> str:
    """Say in one line what all studies come to."""
    studies = [line.study for line in lines]
    n_done = sum(len(study.records) for study in studies)
    parts = [f"{count(n_done)} of {count(sum(study.n_planned for study in studies), 'trial')} done"]
    for state in ("pruned", "failed"):
        number = sum(study.count(state) for study in studies)
        parts += [f"{count(number)} {state}"] if number else []
    n_running = sum(len(study.running) for study in studies)
    parts += [f"{count(n_running)} running"] if n_running else []
    spent_s = sum(record.wall_s for study in studies for record in study.records)
    parts.append(f"{format_seconds(spent_s)} of training")
    to_go_s = _to_go_s(lines)
    parts += [] if to_go_s is None else [f"about {format_seconds(to_go_s)} to go"]
    return f"{count(len(studies), 'study', 'studies')}: {', '.join(parts)}"


def _to_go_s(lines: Sequence[StudyLine]) -> float | None:
    """Return when all that is begun will be finished, at the pace of what runs. [s]."""
    rate = sum(line.pace.trials_per_h or 0.0 for line in lines if line.pace.mood == "running") / 3600.0
    active = [line.study for line in lines if line.pace.mood in ("running", "waiting")]
    left = sum(study.n_planned - len(study.records) for study in active)
    begun = sum(t.epoch / t.max_epochs for study in active for t in study.running if t.max_epochs)
    if not rate:
        return None
    return max(max(left - begun, 0.0) / rate, *(line.pace.to_go_s or 0.0 for line in lines))


def _running(lines: Sequence[StudyLine]) -> Table:
    columns = [
        Column("running"),
        Column("epoch", True),
        Column("", spare=3),
        Column("MAE val", True),
        Column("process", spare=2),
        Column("last sign", True, 1),
    ]
    rows = []
    for line in lines:
        for trial in (*line.study.running, *line.study.lost):
            part = trial.epoch / trial.max_epochs if trial.max_epochs else 0.0
            full = round(N_BAR * min(part, 1.0))
            rows.append(
                [
                    f"{line.study.called}/{trial_name(trial.index)}",
                    f"{trial.epoch}/{trial.max_epochs}" if trial.max_epochs else MISSING,
                    Said("━" * full + "─" * (N_BAR - full), "good"),
                    error(trial.value),
                    f"{trial.owner.get('host', '?')}:{trial.owner.get('pid', '?')}",
                    Said("lost", "warn") if trial in line.study.lost else ago(trial.heard_s),
                ]
            )
    return Table("", columns, rows, is_dense=True)


def calibrations_table(project: Project, stages: Sequence[StageLook]) -> Table:
    """Return a line per calibration, the best of each label standing out."""
    columns = [
        Column("calibration"),
        Column("final MSE", True),
        Column("calls (paper)", True),
        Column("calls (all)", True, 2),
        Column("ended because", spare=3),
        Column("finished", True, 1),
    ]
    changed = {stage.name: ", ".join(changed_since(project, stage)) for stage in stages}
    if any(changed.values()):
        columns.append(Column("changed since"))
    least = {label: min(s.mse for s in stages if s.label == label) for label in {s.label for s in stages}}
    rows = []
    for stage in stages:
        unit = squared(project.unit_of(stage.label))
        is_best = stage.mse == least[stage.label] and math.isfinite(stage.mse)
        mse = quantity(stage.mse, unit, 4) if math.isfinite(stage.mse) else "failed"
        reason = stage.summary.get("polish_stop_reason", stage.summary.get("stop_reason", ""))
        rows.append(
            [
                stage.name,
                Said(mse, "strong" if is_best else ""),
                f"{stage.n_calls} + {stage.n_known} stored" if stage.n_known else stage.n_calls,
                stage.summary["ledger"]["total_honest"],
                reason,
                str(stage.manifest.get("finished", ""))[:16].replace("T", " "),
                *([Said(changed[stage.name], "warn")] if any(changed.values()) else []),
            ]
        )
    return Table("", columns, rows, is_dense=True)
