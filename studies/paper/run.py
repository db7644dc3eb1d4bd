"""Run one item of the paper as a stage: finished ones are read, new ones written, told to the tracker."""

from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from studies.paper.catalog import Item, item_module
from studies.paper.plan import Plan
from studies.paper.result import ItemResult, item_folder, write_result
from studies.paper.size_files import Origin
from studies.paper.telling import tell_item
from studies.paths import ProjectPaths
from studies.stages.knowledge import declared_inputs
from studies.stages.pipeline import Outcome, Stage, Summary, digest_of, read_manifest


def item_inputs(plan: Plan, item: Item) -> dict[str, Any]:
    """Return all that decides an item's result."""
    case = plan.study.case
    return {
        "item": item.name,
        "case": case.digest,
        "measurement": case.measurement.digest,
        **declared_inputs(case),
        "seed": plan.study.profile.seed,
        **item_module(item).inputs(plan),
    }


def is_finished(plan: Plan, item: Item) -> bool:
    """Say whether an item of these inputs lies on disk."""
    study = plan.study
    manifest = study.results / f"paper/{item.name}.json"
    return read_manifest(study.paths, manifest, digest_of(item_inputs(plan, item))) is not None


def estimates_s(plan: Plan, items: tuple[Item, ...]) -> dict[str, float]:
    """Estimate how long items take, what is finished left out. [s].

    Args:
        plan: what is repeated, and with how much.
        items: which ones, in the order of the paper.
    """
    return {
        item.name: 0.0 if is_finished(plan, item) else item_module(item).estimate_s(plan) for item in items
    }


def write_drawn(
    paths: ProjectPaths, item: Item, origin: Origin, result: ItemResult, command: str
) -> list[Path]:
    """Write an item as it was drawn from the files of an earlier run.

    It does not count as finished: without these files the item makes its own.

    Args:
        paths: the project.
        item: which one.
        origin: where the files come from.
        result: what they come to.
        command: what draws it.

    Returns:
        The files, the JSON file first.
    """
    head = _head(item, command, origin.case, origin.label, origin.note, origin.budget, origin.profile)
    folder = paths.results(origin.label) / "paper" / item.name
    return write_result(folder, replace(result, uses=(origin.command,)), head)


def _head(
    item: Item, command: str, case: str, label: str, note: str, budget: str, profile: str
) -> dict[str, str]:
    """Return what stands before an item's result in its JSON file."""
    return {
        "item": item.name,
        "title": item.title,
        "command": command,
        "case": case,
        "label": label,
        "note": note,
        "budget": budget,
        "profile": profile,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def run_item(plan: Plan, item: Item, *, again: bool = False) -> Outcome:
    """Make one item unless it is finished.

    Args:
        plan: what is repeated, and with how much.
        item: which one.
        again: make it though it is finished; its stages are not repeated.
    """
    study = plan.study
    stage = Stage(study, f"paper/{item.name}", item.what, item_inputs(plan, item))
    before = stage.finished(lambda summary: str(summary["agreement"]), again=again)
    if before is not None:
        return before
    with stage.work() as work:
        result = item_module(item).run(plan)
        case, budget, profile = study.case, plan.budget.name, study.profile.name
        head = _head(item, plan.command(item.name), case.name, study.label, case.note, budget, profile)
        folder = item_folder(study, item.name)
        files = write_result(folder, result, head)
        tell_item(
            study.paths,
            files,
            stage.digest,
            case_digest=study.case.digest,
            started_s=work.started_s,
            wall_s=work.wall_s,
        )
        summary: Summary = {
            "agreement": result.agreement,
            "verdict": result.verdict,
            "n_calls": sum(result.n_calls.values()),
            "work_s": round(result.work_s, 1),
            "folder": study.paths.recorded(folder),
        }
        return work.keep(summary, files)
