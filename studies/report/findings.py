"""Numbers that figures, tables and sentences derive from the records, each computed once and here."""

from __future__ import annotations

import math

import numpy as np

from simulation.parameters import ParameterSpace
from studies.report.records import (
    CalibrationRecord,
    CoverageSet,
    Floats,
    Integers,
    MeasuredSeries,
)
from studies.report.records_tuning import TrialsRecord
from studies.report.wording import bound_at


def good_rows(coverage: CoverageSet) -> Floats:
    """Return the trajectories of the rows that did not fail. Shape (n_good, t, k)."""
    return coverage.y[np.isfinite(coverage.y).all(axis=(1, 2))]


def enclosed_fraction(measurement: MeasuredSeries, coverage: CoverageSet) -> float:
    """Return the fraction of measured values between the lowest and the highest simulated at their time."""
    good = good_rows(coverage)
    if not len(good):
        return math.nan
    differences = [measurement.measurement.differences(good, k) for k in range(len(measurement.output_names))]
    inside = [(above.min(axis=0) <= 0.0) & (above.max(axis=0) >= 0.0) for above in differences]
    return float(np.mean(np.concatenate(inside)))


def best_trials(trials: TrialsRecord) -> Integers:
    """Return the positions of the chosen trials with a known test error, smallest training set first."""
    best = np.flatnonzero(trials.is_best & np.isfinite(trials.test_mae))
    return best[np.argsort(trials.n_train[best], kind="stable")].astype(np.int64)


def at_bound(parameters: ParameterSpace, calibration: CalibrationRecord) -> tuple[str, ...]:
    """Say for every parameter whether its polished value lies at a bound: "lower", "upper" or nothing."""
    return tuple(map(bound_at, parameters.to_unit(calibration.theta_polished).tolist()))


def within_sensor(measurement: MeasuredSeries, calibration: CalibrationRecord, output: int) -> float:
    """Return the fraction of the values that the polished model meets within the sensor's uncertainty. [1].

    NaN where the sensor's uncertainty is undeclared, or nothing was simulated.
    """
    residual = measurement.residual(calibration.y_polished, output)
    known, uncertainty = residual[np.isfinite(residual)], float(measurement.uncertainty[output])
    if not known.size or not math.isfinite(uncertainty):
        return math.nan
    return float(np.mean(np.abs(known) <= uncertainty))
