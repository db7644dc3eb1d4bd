"""Numbers that figures, tables and sentences derive from the records, each computed once and here."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from studies.report.records import (
    CalibrationRecord,
    CoverageSet,
    Floats,
    Integers,
    MeasuredSeries,
    ParameterBox,
)
from studies.report.records_tuning import TrialsRecord
from studies.report.wording import bound_at


def quartiles(values: Floats) -> Floats:
    """Return lower quartile, median and upper quartile; a quartile between two values is their mean.

    Args:
        values: Infinite where a target was never reached. Shape (n,).

    Returns:
        Shape (3,).
    """
    # NumPy's would be NaN beside an infinite value.
    ordered, places = np.sort(values), len(values) * np.array([0.25, 0.5, 0.75])
    lower, upper = np.ceil(places).astype(int) - 1, np.floor(places).astype(int)
    return np.asarray(0.5 * (ordered[lower] + ordered[upper]), dtype=np.float64)


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


def strongest_correlation(coverage: CoverageSet) -> tuple[float, int, int] | None:
    """Return the linear correlation of largest size among the sampled parameters, and whose it is."""
    n, p = coverage.theta.shape
    if n < 3 or p < 2 or np.any(np.ptp(coverage.theta, axis=0) == 0):
        return None
    correlation = np.atleast_2d(np.corrcoef(coverage.theta, rowvar=False))
    rows, columns = np.tril_indices(p, k=-1)
    k = int(np.argmax(np.abs(correlation[rows, columns])))
    return float(correlation[rows[k], columns[k]]), int(columns[k]), int(rows[k])


def best_trials(trials: TrialsRecord) -> Integers:
    """Return the positions of the chosen trials with a known test error, smallest training set first."""
    best = np.flatnonzero(trials.is_best & np.isfinite(trials.test_mae))
    return best[np.argsort(trials.n_train[best], kind="stable")].astype(np.int64)


def at_bound(parameters: ParameterBox, calibration: CalibrationRecord) -> tuple[str, ...]:
    """Say for every parameter whether its polished value lies at a bound: "lower", "upper" or nothing."""
    return tuple(map(bound_at, parameters.to_unit(calibration.theta_polished).tolist()))


@dataclass(frozen=True)
class Residual:
    """How the polished model differs from the measurement in one output.

    Attributes:
        rms: Root mean square. [output unit, differences]
        bias: Mean, positive where the model is above. [output unit, differences]
        largest: The largest difference in size, with its sign. [output unit, differences]
        largest_at_s: When that was. [s]
        within: Fraction of the values within the sensor uncertainty; NaN where that is undeclared. [1]
    """

    rms: float
    bias: float
    largest: float
    largest_at_s: float
    within: float


def residual_of(measurement: MeasuredSeries, calibration: CalibrationRecord, output: int) -> Residual | None:
    """Describe the residual of the polished model in one output; None where nothing is known of it."""
    residual = measurement.residual(calibration.y_polished, output)
    known = np.flatnonzero(np.isfinite(residual))
    if not known.size:
        return None
    values = residual[known]
    worst = int(known[np.argmax(np.abs(values))])
    uncertainty = float(measurement.uncertainty[output])
    return Residual(
        rms=float(np.sqrt(np.mean(values**2))),
        bias=float(np.mean(values)),
        largest=float(residual[worst]),
        largest_at_s=float(measurement.samples[output].time[worst]),
        within=float(np.mean(np.abs(values) <= uncertainty)) if math.isfinite(uncertainty) else math.nan,
    )
