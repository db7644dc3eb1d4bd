"""What each picture says, in one sentence made of numbers from the data."""

from __future__ import annotations

import math

import numpy as np

from simulation.measurement import Measurement
from studies.report.data import ReportData
from studies.report.guideline14 import guideline_sentence, judge
from studies.report.records import CalibrationRecord, CoverageSet, Floats, MeasuredSeries
from studies.report.wording import (
    count,
    difference_unit,
    percent,
    quantity,
)


def headline_sentence(data: ReportData) -> str:
    """Say the result of the study in one sentence; tables have its calls by purpose."""
    c = data.headline
    if c is None:
        return "Nothing has been calibrated yet."
    made = count(c.calls_paper, "model call") if c.calls_paper else "No model call"
    known = f" beside {count(c.n_known, 'stored simulation')}" if c.n_known else ""
    return (
        f"{made}{known} calibrated "
        f"{count(len(data.parameters.names), 'parameter')} to an MSE of "
        f"{quantity(c.mse_polished, data.measurement.mse_unit)}."
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
    return " ".join(filter(None, parts))


def coverage_caption(measurement: MeasuredSeries, coverage: CoverageSet) -> str:
    """Say whether the simulated set could have produced the measurement."""
    n_failed = len(coverage.y) - len(coverage.good)
    failed = f" {count(n_failed, 'simulation')} failed." if n_failed else ""
    share = percent(enclosed_fraction(measurement.measurement, coverage.good))
    return f"{share} of the measured values lie between the lowest and the highest simulated one.{failed}"


def enclosed_fraction(measurement: Measurement, y: Floats) -> float:
    """Return the fraction of measured values between the lowest and the highest simulated at their time. [1].

    Args:
        measurement: What was measured.
        y: Trajectories without failed ones. Shape (n, t, k). [units]
    """
    if not len(y):
        return math.nan
    differences = [measurement.differences(y, k) for k in range(len(measurement.output_names))]
    inside = [(above.min(axis=0) <= 0.0) & (above.max(axis=0) >= 0.0) for above in differences]
    return float(np.mean(np.concatenate(inside)))


def within_sensor(measurement: MeasuredSeries, calibration: CalibrationRecord, output: int) -> float:
    """Return the fraction of the values that the polished model meets within the sensor's uncertainty. [1].

    NaN where the sensor's uncertainty is undeclared, or nothing was simulated.
    """
    residual = measurement.residual(calibration.y_polished, output)
    known, uncertainty = residual[np.isfinite(residual)], float(measurement.uncertainty[output])
    if not known.size or not math.isfinite(uncertainty):
        return math.nan
    return float(np.mean(np.abs(known) <= uncertainty))
