"""Building a report: its pictures drawn, its tables written, all of it put on one page."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from simulation.time_unit import period_text
from simulation.whole_file import whole_file
from studies.report.captions import headline_sentence
from studies.report.contents import sections_of
from studies.report.data import ReportData
from studies.report.page import KeyNumber, page
from studies.report.wording import count, quantity

SUMMARY = "report.json"
PAGE = "index.html"


def build_report(data: ReportData, folder: Path) -> Path:
    """Write the report into a folder; see `studies.report.build`."""
    sections = sections_of(data)
    parts = [part for section in sections for part in (section, *section.folded)]
    pictures = [picture for part in parts for picture in part.pictures]
    tables = [table for part in parts for table in part.tables]
    lead, numbers = headline_sentence(data), _key_numbers(data)
    files = {picture.file: picture.figure.to_csv() for picture in pictures}
    files |= {f"{table.name}.csv": table.to_csv() for table in tables}
    files[PAGE] = page(data, lead, numbers, sections)
    summary = {
        "schema": 1,
        "label": data.label,
        "result": lead,
        "headline": [asdict(number) for number in numbers],
        "tables": {table.name: table.records() for table in tables},
        "figures": [{"file": p.file, "heading": p.figure.title, "caption": p.caption} for p in pictures],
        "provenance": asdict(data.provenance),
        "files": sorted([*files, SUMMARY]),
    }
    files[SUMMARY] = json.dumps(summary, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    folder.mkdir(parents=True, exist_ok=True)
    for earlier in (*folder.glob("*.csv"), *folder.glob("*.png")):
        earlier.unlink()
    for name, text in files.items():
        with whole_file(folder / name) as file:
            file.write(text.encode())
    return folder / PAGE


def _key_numbers(data: ReportData) -> list[KeyNumber]:
    c = data.headline
    if c is None:
        return []
    mse_unit = data.measurement.mse_unit
    screened = "" if c.is_adaptive else f", {quantity(c.mse_screened, mse_unit)} as screened"
    numbers = [KeyNumber(quantity(c.mse_polished, mse_unit), f"final MSE ({c.shown_name}){screened}")]
    if c.is_adaptive:
        beside = f"beside {count(c.n_known, 'simulation')} stored before"
        all_of_them = beside if c.n_known else "which are all that was simulated for it"
        numbers += [KeyNumber(count(c.total_calls), f"model calls, {all_of_them}")]
    else:
        numbers += [
            KeyNumber(count(c.calls_paper), "model calls: training, screening check and polish"),
            KeyNumber(count(c.total_calls), "simulations in all, validation and test sets included"),
        ]
    validation = data.validation_of(c)
    if validation is not None:
        meaning = f"MSE on {period_text(validation.period_d)}, which the calibration did not see"
        mse = validation.final.mse
        numbers.append(KeyNumber("failed" if mse is None else quantity(mse, mse_unit), meaning))
    for target in (r for r in data.references if r.is_target):
        calls = c.calls_to(target.mse)
        what = f"MSE {quantity(target.mse, mse_unit)} ({target.label})"
        numbers.append(KeyNumber(count(calls) if calls is not None else "never", f"model calls until {what}"))
    return numbers
