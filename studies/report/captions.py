"""What each picture says, in one sentence made of numbers from the data."""

from __future__ import annotations

import math

import numpy as np

from studies.report.data import ReportData
from studies.report.findings import enclosed_fraction, good_rows, within_sensor
from studies.report.guideline14 import guideline_sentence, judge
from studies.report.records import CalibrationRecord, CoverageSet, MeasuredSeries
from studies.report.wording import (
    count,
    difference_unit,
    percent,
    quantity,
    squared,
)


def mse_unit(measurement: MeasuredSeries) -> str:
    """Return the unit of an MSE: the first output's, squared."""
    return squared(difference_unit(measurement.units[0]))


def headline_sentence(data: ReportData) -> str:
    """Say the result of the study in one sentence; tables and cards have its calls by purpose."""
    c = data.headline
    if c is None:
        return "Nothing has been calibrated yet."
    made = count(c.calls_paper, "model call") if c.calls_paper else "No model call"
    known = f" beside {count(c.n_known, 'stored simulation')}" if c.n_known else ""
    return (
        f"{made}{known} calibrated "
        f"{count(len(data.parameters.names), 'parameter')} to an MSE of "
        f"{quantity(c.mse_polished, mse_unit(data.measurement))}."
    )


def calibration_caption(measurement: MeasuredSeries, calibration: CalibrationRecord) -> str:
    """Say how the final model compares with the sensor and with ASHRAE guideline 14."""
    parts = []
    for k, name in enumerate(measurement.output_names):
        share = within_sensor(measurement, calibration, k)
        if math.isfinite(share):
            sensor = f"±{float(measurement.uncertainty[k]):g} {difference_unit(measurement.units[k])}".strip()
            parts.append(f"{percent(share)} of the values of {name} lie within the sensor's {sensor}.")
    if np.isfinite(calibration.y_polished).all():
        found = judge(measurement.measurement, measurement.units, calibration.y_polished)
        parts.append(guideline_sentence(found))
    return " ".join(parts)


def coverage_caption(measurement: MeasuredSeries, coverage: CoverageSet) -> str:
    """Say whether the simulated set could have produced the measurement."""
    n_failed = len(coverage.y) - len(good_rows(coverage))
    failed = f" {count(n_failed, 'simulation')} failed." if n_failed else ""
    share = percent(enclosed_fraction(measurement, coverage))
    return f"{share} of the measured values lie between the lowest and the highest simulated one.{failed}"
