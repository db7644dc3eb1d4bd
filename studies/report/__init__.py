"""Reports: tables and figures made from results that lie on disk.

Figures are functions of plain records (`studies.report.records`), and this package is the only place that
knows Vega-Lite. Importing it loads no drawing library; `build` does, when it is called.
"""

from __future__ import annotations

from pathlib import Path

from studies.report.data import Provenance, ReportData
from studies.report.records import CalibrationRecord, CoverageSet, MeasuredSeries
from studies.report.records_tuning import TrialsRecord

__all__ = [
    "CalibrationRecord",
    "CoverageSet",
    "MeasuredSeries",
    "Provenance",
    "ReportData",
    "TrialsRecord",
    "build",
]


def build(data: ReportData, folder: Path) -> Path:
    """Write a report: one self-contained page, its values as CSV, and a machine-readable summary.

    Args:
        data: What to show.
        folder: Where to; made if missing. Files of an earlier report are removed.

    Returns:
        The path of index.html.
    """
    from studies.report.builder import build_report

    return build_report(data, folder)
