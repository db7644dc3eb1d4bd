"""What an item of the paper comes to: numbers, verdict, tables and pictures, written as plain files."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from simulation.errors import InputError
from studies.report.page import Picture, Section, Verdict
from studies.report.tables import Cell, Column, Table
from studies.report.wording import count, declared, percent, significant, squared
from studies.stages.pipeline import Study, read_json, write_json, write_text

Agreement = Literal["agrees", "agrees in part", "differs", "beyond the paper"]

RESULT = "result.json"
SCHEMA = 1


def fraction2(value: float) -> str:
    """Write a number with two decimals."""
    return f"{value:.2f}"


ERROR, SQUARED_ERROR = "error", "squared error"
"""Units of declared columns that the case's first output decides."""

WRITERS: dict[str, Callable[[float], str]] = {
    "significant": significant,
    "count": count,
    "declared": declared,
    "percent": percent,
    "fraction2": fraction2,
}


@dataclass(frozen=True)
class ItemResult:
    """What an item comes to.

    Args:
        agreement: how it compares with the paper, in a word.
        verdict: the same in an honest paragraph: agrees, differs, why.
        numbers: all results as JSON values; nothing of the recording itself.
        paper: the paper's values, as JSON values.
        tables: rows for page and CSV.
        pictures: still to be drawn.
        n_calls: rows asked of the physical model, by purpose.
        work_s: time spent on it, finished stages included. [s]
        seeds: what was drawn with which seed.
        settings: what a reader must know to judge it: pairs of name and value.
        metrics: single numbers for the tracking product; those that are None or not finite are left out.
        remarks: further paragraphs, e.g. how a vague sentence of the paper was read.
        uses: commands of the stages behind it.
        files: further files that it has written into its folder.
    """

    agreement: Agreement
    verdict: str
    numbers: Mapping[str, Any]
    paper: Mapping[str, Any]
    tables: tuple[Table, ...]
    pictures: tuple[Picture, ...]
    n_calls: Mapping[str, int]
    work_s: float
    seeds: Mapping[str, int | list[int]]
    settings: tuple[tuple[str, str], ...] = ()
    metrics: Mapping[str, float | None] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()


def columns_in(unit: str, declared_columns: Sequence[tuple[str, str, str]]) -> tuple[Column, ...]:
    """Return the columns of a table.

    Args:
        unit: unit of an error.
        declared_columns: key, title, and unit: a unit as it is written, or `ERROR` or `SQUARED_ERROR`.
    """
    units = {ERROR: unit, SQUARED_ERROR: squared(unit)}
    return tuple(Column(key, title, units.get(known, known)) for key, title, known in declared_columns)


def item_folder(study: Study, name: str) -> Path:
    """Return where an item's pictures, tables and numbers lie."""
    return study.results / "paper" / name


def stored_item(study: Study, name: str) -> dict[str, Any] | None:
    """Return what lies on disk of an item, whatever it was made with."""
    return read_json(item_folder(study, name) / RESULT)


def numbers_of(study: Study, name: str) -> dict[str, Any]:
    """Return the numbers of a finished item.

    Raises:
        InputError: it is not there.
    """
    stored = stored_item(study, name)
    if stored is None:
        raise InputError(f"{name} is not there yet; type: studies reproduce-paper --only {name}")
    numbers: dict[str, Any] = stored["numbers"]
    return numbers


def write_result(folder: Path, result: ItemResult, head: Mapping[str, Any]) -> list[Path]:
    """Draw the pictures and write tables and numbers of an item.

    Args:
        folder: where to.
        result: the item's result.
        head: what stands before the result in the JSON file.

    Returns:
        The files, the JSON file first.
    """
    files = [folder / RESULT, *result.files]
    for picture in result.pictures:
        if picture.draw is not None:
            picture.draw(folder / picture.file)
        files.append(folder / picture.file)
    for table in result.tables:
        files.append(folder / f"{table.name}.csv")
        write_text(files[-1], table.to_csv())
    write_json(
        folder / RESULT,
        {
            "schema": SCHEMA,
            **head,
            "agreement": result.agreement,
            "verdict": result.verdict,
            "remarks": list(result.remarks),
            "n_calls": {**result.n_calls, "total": sum(result.n_calls.values())},
            "work_s": round(result.work_s, 1),
            "seeds": dict(result.seeds),
            "settings": dict(result.settings),
            "metrics": {name: value for name, value in finite(result.metrics).items() if value is not None},
            "uses": list(result.uses),
            "paper": finite(dict(result.paper)),
            "numbers": finite(dict(result.numbers)),
            "tables": [_table_values(table) for table in result.tables],
            "pictures": [
                {"file": p.file, "heading": p.heading, "caption": p.caption} for p in result.pictures
            ],
        },
    )
    return files


def section_of(folder: Path, title: str, stored: Mapping[str, Any]) -> Section:
    """Return an item that lies on disk as a part of the page."""
    calls = ", ".join(f"{count(n)} {what}" for what, n in stored["n_calls"].items() if what != "total")
    seeds = ", ".join(f"{what} {_listed(seed)}" for what, seed in stored["seeds"].items())
    facts = [
        ("again, alone", stored["command"]),
        ("stages behind it", "; ".join(stored["uses"])),
        ("model calls", f"{count(stored['n_calls']['total'])} ({calls})" if calls else "none"),
        ("work", f"{stored['work_s']:,.0f} s, budget {stored['budget']}, finished {stored['finished']}"),
        ("seeds", seeds),
        *((name, str(value)) for name, value in stored["settings"].items()),
    ]
    return Section(
        stored["item"],
        title,
        pictures=tuple(
            Picture(Path(picture["file"]).stem, picture["heading"], picture["caption"])
            for picture in stored["pictures"]
            if (folder / picture["file"]).is_file()
        ),
        tables=tuple(_table_of(values) for values in stored["tables"]),
        verdict=Verdict(_sentence(stored["agreement"]), stored["verdict"]),
        paragraphs=tuple(stored["remarks"]),
        facts=tuple((name, value) for name, value in facts if value),
        folder=folder,
    )


def finite(value: Any) -> Any:
    """Return JSON values in which what is not finite is None."""
    if isinstance(value, Mapping):
        return {str(key): finite(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [finite(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:]


def _listed(seed: int | list[int]) -> str:
    return ", ".join(map(str, seed)) if isinstance(seed, list) else str(seed)


def _table_values(table: Table) -> dict[str, Any]:
    names = {writer: name for name, writer in WRITERS.items()}
    return {
        "name": table.name,
        "title": table.title,
        "columns": [
            {"key": c.key, "title": c.title, "unit": c.unit, "write": names[c.write]} for c in table.columns
        ],
        "rows": finite([list(row) for row in table.rows]),
        "emphasized": table.emphasized,
    }


def _table_of(values: Mapping[str, Any]) -> Table:
    rows: list[list[Cell]] = values["rows"]
    return Table(
        values["name"],
        values["title"],
        tuple(Column(**{**column, "write": WRITERS[column["write"]]}) for column in values["columns"]),
        tuple(tuple(row) for row in rows),
        values["emphasized"],
    )
