"""Run one item of the paper as a stage: finished ones are read, new ones written, told to the tracker."""

import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from studies.paper.catalog import Item, item_module
from studies.paper.plan import Plan
from studies.paper.result import item_folder, write_result
from studies.paper.telling import tell_item
from studies.stages.knowledge import declared_inputs
from studies.stages.pipeline import Outcome, Summary, digest_of, read_manifest, run_stage


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
    """Estimate how long items take, what is finished or shared left out. [s].

    Args:
        plan: what is repeated, and with how much.
        items: which ones, in the order of the paper.
    """
    costs, trained = {}, False
    for item in items:
        costs[item.name] = 0.0 if is_finished(plan, item) else item_module(item).estimate_s(plan)
        if item.trains_own_window:
            if trained and costs[item.name]:
                costs[item.name] -= plan.window_training_s
            trained = True
    return costs


def run_item(plan: Plan, item: Item, *, again: bool = False) -> Outcome:
    """Make one item unless it is finished.

    Args:
        plan: what is repeated, and with how much.
        item: which one.
        again: make it though it is finished; its stages are not repeated.
    """
    study, stage = plan.study, f"paper/{item.name}"
    inputs = item_inputs(plan, item)

    def work() -> tuple[Summary, list[Path]]:
        started_s = time.time()
        result = item_module(item).run(plan)
        head = {
            "item": item.name,
            "title": item.title,
            "command": plan.command(item.name),
            "case": study.case.name,
            "label": study.label,
            "note": study.case.note,
            "budget": plan.budget.name,
            "profile": study.profile.name,
            "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        folder = item_folder(study, item.name)
        files = write_result(folder, result, head)
        tell_item(
            study.paths,
            files,
            digest_of(inputs),
            case_digest=study.case.digest,
            started_s=started_s,
            wall_s=time.time() - started_s,
        )
        summary: Summary = {
            "agreement": result.agreement,
            "verdict": result.verdict,
            "n_calls": sum(result.n_calls.values()),
            "work_s": round(result.work_s, 1),
            "folder": study.paths.recorded(folder),
        }
        return summary, files

    return run_stage(
        study,
        stage,
        what=item.what,
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: summary["agreement"],
        again=again,
    )
