"""Everything of the paper that lies on disk: on one page, and as one JSON file that can be committed."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from studies.paper.catalog import ITEMS
from studies.paper.plan import Plan
from studies.paper.result import item_folder, section_of, stored_item
from studies.report import Provenance
from studies.report.page import Card, Section, page
from studies.report.wording import count, listed
from studies.stages.pipeline import Study, write_json, write_text
from studies.tracking.origin import versions

PAGE = "index.html"
FOOTER = (
    "Pictures (PNG), tables (CSV) and numbers (JSON) lie in the folder of each item below "
    "mlruns/results; the page itself needs none of them."
)
EXPORT_SCHEMA = 1
_NOT_EXPORTED = ("tables", "pictures")


@dataclass(frozen=True)
class _Head:
    label: str
    title: str
    note: str
    provenance: Provenance


def build_page(plan: Plan) -> Path:
    """Write the page from what lies on disk; an item that is missing says which command makes it.

    Args:
        plan: names the items' commands, and the study they belong to.

    Returns:
        The page.
    """
    study = plan.study
    found = {item.name: stored_item(study, item.name) for item in ITEMS}
    sections = [
        _section(plan, item.name, item.title, found[item.name])
        for item in ITEMS
        if item.is_about(study.case.name)
    ]
    there = [stored for stored in found.values() if stored is not None]
    budgets = sorted({stored["budget"] for stored in there})
    note = " ".join([study.case.note, *(_budget_note(plan, name) for name in budgets)]).strip()
    head = _Head(
        study.label,
        f"The paper, reproduced: {study.case.title}",
        note,
        Provenance(
            commands=(f"studies reproduce-paper {plan.words}".strip(),),
            settings=(
                ("case", study.case.name),
                ("profile", study.profile.name),
                ("seed", str(study.profile.seed)),
                ("items there", f"{len(there)} of {len(ITEMS)}"),
            ),
            digests=(("case", study.case.digest), ("FMU", study.case.fmu.sha256)),
            versions=tuple(versions().items()),
        ),
    )
    index = page_file(study)
    write_text(index, page(head, _lead(there), _cards(there), sections, footer=FOOTER))
    return index


def page_file(study: Study) -> Path:
    """Return where the page lies."""
    return study.paths.report(study.label) / "paper" / PAGE


def export(study: Study, file: Path) -> None:
    """Write the numbers of all items to one JSON file: results only, nothing of the recording.

    Args:
        study: whose items.
        file: where to.
    """
    items = {}
    for item in ITEMS:
        stored = stored_item(study, item.name)
        if stored is not None:
            items[item.name] = {name: part for name, part in stored.items() if name not in _NOT_EXPORTED}
    write_json(
        file,
        {
            "schema": EXPORT_SCHEMA,
            "paper": "https://doi.org/10.3384/ecp204107",
            "case": study.case.name,
            "label": study.label,
            "case_sha256": study.case.digest,
            "versions": versions(),
            "items": items,
        },
    )


def _section(plan: Plan, name: str, title: str, stored: Mapping[str, Any] | None) -> Section:
    if stored is None:
        missing = f"Not there yet. This makes it: {plan.command(name)}"
        return Section(name, title, paragraphs=(missing,))
    return section_of(item_folder(plan.study, name), title, stored)


def _lead(there: list[dict[str, Any]]) -> str:
    if not there:
        return "Nothing of the paper has been reproduced yet."
    words = ("agrees", "agrees in part", "differs", "beyond the paper")
    counted = [(word, [s["item"] for s in there if s["agreement"] == word]) for word in words]
    said = [f"{word}: {listed(items)}" for word, items in counted if items]
    return f"{count(len(there), 'item')} of {len(ITEMS)}. {'; '.join(said)}."


def _cards(there: list[dict[str, Any]]) -> list[Card]:
    calls = sum(stored["n_calls"]["total"] for stored in there)
    hours = sum(stored["work_s"] for stored in there) / 3600.0
    cards = [
        Card(f"{len(there)} of {len(ITEMS)}", "tables and figures are there"),
        Card(count(calls), "calls of the model, counted at the model"),
        Card(f"{hours:.1f} h", "of work, stages of several items counted with each"),
    ]
    return cards if there else []


def _budget_note(plan: Plan, name: str) -> str:
    return plan.budget.note if name == plan.budget.name else f"Some items were made with the budget {name}."
