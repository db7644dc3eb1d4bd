"""Building a report: its pictures drawn, its tables written, all of it put on one page."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from simulation.foreign_file import RECORD, read_limited
from simulation.time_unit import period_text
from simulation.whole_file import whole_file
from studies.report import captions
from studies.report.contents import Contents, Picture, contents_of
from studies.report.data import ReportData
from studies.report.findings import residual_of
from studies.report.page import Card, PlacedPicture, Section, page
from studies.report.records import CalibrationRecord
from studies.report.restriction_told import restriction_sentences, unrestricted
from studies.report.tables import Table
from studies.report.uncertainty import sentences
from studies.report.wording import count, difference_unit, percent, quantity, significant

OnProgress = Callable[[int, int], None]
SUMMARY = "report.json"
PAGE = "index.html"


def build_report(data: ReportData, folder: Path, *, on_progress: OnProgress | None = None) -> Path:
    """Write the report into a folder; see `studies.report.build`."""
    contents = contents_of(data)
    files = [picture.file for picture in contents.pictures]
    files += [f"{name}{ending}" for name in contents.tables for ending in (".md", ".csv")]
    total = len(files) + 2
    folder.mkdir(parents=True, exist_ok=True)
    outdated = _files_of_earlier_report(folder) - {*files, SUMMARY, PAGE}
    n_done = 0

    def done() -> None:
        nonlocal n_done
        n_done += 1
        if on_progress is not None:
            on_progress(n_done, total)

    for picture in contents.pictures:
        picture.draw(folder / picture.file)
        done()
    for name, table in contents.tables.items():
        for ending, text in ((".md", table.to_markdown()), (".csv", table.to_csv())):
            _write(folder / f"{name}{ending}", text)
            done()
    lead, cards = captions.headline_sentence(data), _cards(data)
    index = folder / PAGE
    _write(index, page(data, lead, cards, _sections(data, contents, folder)))
    done()
    summary = _summary(data, contents, lead, cards) | {"files": sorted([*files, PAGE, SUMMARY])}
    _write(folder / SUMMARY, json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False) + "\n")
    done()
    for name in outdated:
        (folder / name).unlink(missing_ok=True)
    return index


def _sections(data: ReportData, contents: Contents, folder: Path) -> list[Section]:
    def place(pictures: tuple[Picture, ...]) -> tuple[PlacedPicture, ...]:
        return tuple(PlacedPicture(folder / p.file, p.heading, p.caption) for p in pictures)

    def tables(*names: str) -> tuple[Table, ...]:
        return tuple(contents.tables[name] for name in names if name in contents.tables)

    headline, mse_unit = data.headline, captions.mse_unit(data.measurement)

    def told(c: CalibrationRecord) -> tuple[str, ...]:
        said = tuple(f"{line}." for line in (*filter(None, [c.state_equations]), *c.left_open))
        return said + restriction_sentences(c, unrestricted(c, data.calibrations), mse_unit)

    folded = tuple(
        Section(
            c.name,
            f"{c.shown_name}: final MSE {quantity(c.mse_polished, mse_unit)} "
            f"in {count(c.calls_paper, 'call')}",
            place(pictures),
            tables(*_names(c)),
            paragraphs=told(c),
        )
        for c, pictures in contents.others
    )
    return [
        Section("tuned", "Tuned surrogates", tables=tables("tuning"), is_leading=True),
        Section(
            "calibration",
            "Calibration",
            place(contents.calibration),
            tables(*_names(headline)) if headline else (),
            paragraphs=told(headline) if headline else (),
        ),
        *(
            Section(
                f"uncertainty-{record.calibration}",
                f"How sure the {record.calibration} calibration is",
                place(pictures),
                tables(f"uncertainty-{record.calibration}"),
                paragraphs=sentences(record, data.measurement.units),
            )
            for record, pictures in contents.uncertainty
        ),
        Section("sizes", "All calibrations", place(contents.overview), tables("calibrations"), folded),
        Section("surrogate", "All trials, and how the best ones were trained", place(contents.surrogate)),
        Section("model", "The model and its parameters", place(contents.model), tables("sensitivity")),
    ]


def _names(calibration: CalibrationRecord) -> tuple[str, str]:
    """Name the tables of one calibration."""
    return f"parameters-{calibration.name}", f"validation-{calibration.name}"


def _cards(data: ReportData) -> list[Card]:
    c = data.headline
    if c is None:
        return []
    unit, mse_unit = difference_unit(data.measurement.units[0]), captions.mse_unit(data.measurement)
    screened = "" if c.is_adaptive else f", {quantity(c.mse_screened, mse_unit)} as screened"
    cards = [Card(quantity(c.mse_polished, mse_unit), f"final MSE ({c.shown_name}){screened}")]
    if c.is_adaptive:
        beside = f"beside {count(c.n_known, 'simulation')} stored before"
        all_of_them = beside if c.n_known else "which are all that was simulated for it"
        cards += [Card(count(c.calls_honest), f"model calls, {all_of_them}")]
    else:
        cards += [
            Card(count(c.calls_paper), "model calls: training, screening check and polish"),
            Card(count(c.calls_honest), "simulations in all, validation and test sets included"),
        ]
    validation = data.validation_of(c)
    if validation is not None:
        meaning = f"MSE on {period_text(validation.period_d)}, which the calibration did not see"
        cards.append(Card(quantity(validation.points[-1].mse, mse_unit), meaning))
    known = [r for r in data.references if not r.is_target and r.mse > 0]
    if known:
        best = min(known, key=lambda r: r.mse)
        cards.append(Card(f"{significant(c.mse_polished / best.mse)} ×", f"final MSE over {best.label}"))
    for target in (r for r in data.references if r.is_target):
        calls = c.calls_to(target.mse)
        what = f"MSE {quantity(target.mse, mse_unit)} ({target.label})"
        cards.append(Card(count(calls) if calls is not None else "never", f"model calls until {what}"))
    residual = residual_of(data.measurement, c, 0)
    if residual is not None:
        meaning = f"root mean square difference from {data.measurement.output_names[0]} as measured"
        cards.append(Card(quantity(residual.rms, unit), meaning))
        if math.isfinite(residual.within):
            sensor = f"±{float(data.measurement.uncertainty[0]):g} {unit}".strip()
            cards.append(Card(percent(residual.within), f"of the values within the sensor's {sensor}"))
    if math.isfinite(c.test_mae):
        cards.append(
            Card(
                quantity(c.test_mae, unit, 2), f"the surrogate's mean error on the test set ({c.shown_name})"
            )
        )
    return cards


def _summary(data: ReportData, contents: Contents, lead: str, cards: list[Card]) -> dict[str, Any]:
    headline, provenance = data.headline, data.provenance
    return {
        "schema": 1,
        "label": data.label,
        "title": data.title,
        "note": data.note,
        "created": provenance.created,
        "result": lead,
        "headline_n_train": headline.n_train if headline else None,
        "headline_method": headline.method if headline else None,
        "headline": [{"value": card.value, "meaning": card.meaning} for card in cards],
        "mse_unit": captions.mse_unit(data.measurement),
        "references": [{"label": r.label, "mse": r.mse, "is_target": r.is_target} for r in data.references],
        "tables": {name: table.records() for name, table in contents.tables.items()},
        "figures": [{"file": p.file, "heading": p.heading, "caption": p.caption} for p in contents.pictures],
        "provenance": {
            "commands": list(provenance.commands),
            "settings": dict(provenance.settings),
            "digests": dict(provenance.digests),
            "versions": dict(provenance.versions),
        },
    }


def _files_of_earlier_report(folder: Path) -> set[str]:
    """Return what an earlier report says it wrote here; a name that points elsewhere is not believed."""
    try:
        names = json.loads(read_limited(folder / SUMMARY, RECORD))["files"]
    except (ValueError, KeyError, TypeError, RecursionError):
        return set()
    if not isinstance(names, list):
        return set()
    return {
        name
        for name in names
        if isinstance(name, str) and Path(name).name == name and name not in (".", "..")
    }


def _write(path: Path, text: str) -> None:
    with whole_file(path) as file:
        file.write(text.encode())
