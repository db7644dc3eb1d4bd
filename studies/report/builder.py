"""Building a report: its pictures drawn, its tables written, all of it put on one page."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

from simulation.time_unit import period_text
from simulation.whole_file import whole_file
from studies.report import captions
from studies.report.contents import sections_of
from studies.report.data import ReportData
from studies.report.findings import within_sensor
from studies.report.page import Card, page
from studies.report.wording import count, difference_unit, percent, quantity, significant

OnProgress = Callable[[int, int], None]
SUMMARY = "report.json"
PAGE = "index.html"


def build_report(data: ReportData, folder: Path, *, on_progress: OnProgress | None = None) -> Path:
    """Write the report into a folder; see `studies.report.build`."""
    sections = sections_of(data)
    parts = [part for section in sections for part in (section, *section.folded)]
    pictures = [picture for part in parts for picture in part.pictures]
    tables = [table for part in parts for table in part.tables]
    files = [*(picture.file for picture in pictures), *(f"{table.name}.csv" for table in tables)]
    lead, cards, index = captions.headline_sentence(data), _cards(data), folder / PAGE
    summary = {
        "schema": 1,
        "label": data.label,
        "result": lead,
        "headline": [{"value": card.value, "meaning": card.meaning} for card in cards],
        "tables": {table.name: table.records() for table in tables},
        "figures": [{"file": p.file, "heading": p.heading, "caption": p.caption} for p in pictures],
        "provenance": asdict(data.provenance),
        "files": sorted([*files, PAGE, SUMMARY]),
    }
    content = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    work: list[Callable[[], object]] = [
        *(partial(_write, folder / picture.file, picture.figure.to_csv()) for picture in pictures),
        *(partial(_write, folder / f"{table.name}.csv", table.to_csv()) for table in tables),
        lambda: _write(index, page(data, lead, cards, sections)),
        lambda: _write(folder / SUMMARY, content),
    ]
    folder.mkdir(parents=True, exist_ok=True)
    for earlier in (*folder.glob("*.csv"), *folder.glob("*.png")):
        earlier.unlink()
    for n_done, write in enumerate(work, start=1):
        write()
        if on_progress is not None:
            on_progress(n_done, len(work))
    return index


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
        mse = validation.final.mse
        cards.append(Card("failed" if mse is None else quantity(mse, mse_unit), meaning))
    known = [r for r in data.references if not r.is_target and r.mse > 0]
    if known:
        best = min(known, key=lambda r: r.mse)
        cards.append(Card(f"{significant(c.mse_polished / best.mse)} ×", f"final MSE over {best.label}"))
    for target in (r for r in data.references if r.is_target):
        calls = c.calls_to(target.mse)
        what = f"MSE {quantity(target.mse, mse_unit)} ({target.label})"
        cards.append(Card(count(calls) if calls is not None else "never", f"model calls until {what}"))
    within = within_sensor(data.measurement, c, 0)
    if math.isfinite(within):
        sensor = f"±{float(data.measurement.uncertainty[0]):g} {unit}".strip()
        cards.append(Card(percent(within), f"of the values within the sensor's {sensor}"))
    return cards


def _write(path: Path, text: str) -> None:
    with whole_file(path) as file:
        file.write(text.encode())
