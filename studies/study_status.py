"""What `studies status` shows: a line per study and per calibration."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from studies.blocks import number
from studies.console import Block, Column, Table, format_seconds
from studies.project import FIRST_WORDS, FinishedCalibration, Project
from studies.report.records_tuning import TunedSize
from studies.report.wording import MISSING, setting, significant


def status_blocks(project: Project) -> list[Block]:
    """Return what a person sees."""
    blocks: list[Block] = []
    tuned = [one for one in project.sizes if not one.is_baseline]
    if tuned:
        blocks.append(_studies(tuned))
    if project.calibrations:
        blocks.append(_calibrations(project.calibrations))
    return blocks or [f"Nothing in {project.paths.root} yet; {FIRST_WORDS}"]


def status_document(project: Project) -> dict[str, Any]:
    """Return what a program reads."""
    return {
        "command": "status",
        "studies": [asdict(one) for one in project.sizes],
        "calibrations": [one.to_dict() for one in project.calibrations],
    }


def _studies(tuned: Sequence[TunedSize]) -> Table:
    names = list(dict.fromkeys(name for one in tuned for name in one.params))
    units = {one.unit for one in tuned}
    alike = [(one.label, one.n_train) for one in tuned]
    columns = [Column("study"), number("trials"), number("pruned", spare=5), number("failed", spare=8)]
    columns += [number("running", spare=7), *(number(name, spare=2) for name in names)]
    columns += [number("MAE"), number("P90"), number("PCA+GP", spare=3)]
    columns += [number("trials/h", spare=9), number("to go", spare=4)]
    rows = [
        [
            one.study if alike.count((one.label, one.n_train)) > 1 else one.study.rsplit("/", 1)[0],
            f"{one.n_trials}/{one.n_all}",
            one.n_pruned,
            one.n_failed,
            one.n_running,
            *(setting(one.params.get(name)) for name in names),
            *(MISSING if error is None else significant(error) for error in (one.mae, one.p90)),
            significant(one.baseline["test/mae"]) if one.baseline else MISSING,
            f"{3600.0 * one.n_trials / one.wall_s:.0f}" if one.wall_s else MISSING,
            MISSING if one.to_go_s is None else format_seconds(one.to_go_s) if one.to_go_s else "done",
        ]
        for one in tuned
    ]
    unit = f", in {units.pop()}" if len(units) == 1 else ""
    title = f"Studies (errors of the best trial on the test set{unit})"
    return Table(title, columns, rows)


def _calibrations(calibrations: Sequence[FinishedCalibration]) -> Table:
    """Return a line per calibration."""
    names = {one.found.error_name for one in calibrations}
    final = f"final {names.pop()}" if len(names) == 1 else "final error"
    columns = [Column("calibration"), number(final), number("calls (paper)")]
    columns += [number("calls (all)", spare=2), Column("ended because", spare=3), number("finished", spare=1)]
    is_any_changed = any(one.changed_since for one in calibrations)
    columns += [Column("changed since")] * is_any_changed
    rows = []
    for one in calibrations:
        found, calls = one.found, str(one.found.n_calls_paper)
        rows.append(
            [
                one.name,
                one.mse_text,
                f"{calls} + {found.n_warm_start} stored" if found.n_warm_start else calls,
                found.n_calls,
                found.stop_reason,
                one.outcome.finished[:16].replace("T", " "),
                *([", ".join(one.changed_since)] if is_any_changed else []),
            ]
        )
    return Table("", columns, rows)
