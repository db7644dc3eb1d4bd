"""Pictures of calibrations: outputs over time, and MSE over model calls."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from simulation.case import KnownError
from studies.report.drawing import (
    DIAMOND,
    FAINT,
    HOLLOW,
    INK,
    LOG,
    MEASURED,
    POLISHED,
    SCREENED,
    SURROGATE,
    TRAINING,
    Axis,
    Figure,
    Panel,
    Series,
    reference_lines,
    shortened,
    time_axis,
    with_gaps,
)
from studies.report.records import CalibrationRecord, MeasuredSeries
from studies.report.wording import axis_label, count, difference_unit, quantity, shown_unit

MOST_BAND = 3.0
"""The axis of a residual reaches the end of the sensor's band where that is at most so many times as far."""


def output_axis(measurement: MeasuredSeries, output: int) -> Axis:
    """Return the vertical axis of an output in its unit."""
    name, unit = measurement.output_names[output], shown_unit(measurement.units[output])
    return Axis(axis_label(shortened(name), shortened(unit)))


def calibration_figure(measurement: MeasuredSeries, calibration: CalibrationRecord) -> Figure:
    """Show measured, screened and final outputs over time, and the residual of the final below.

    Args:
        measurement: What it is compared with.
        calibration: The calibration to show.
    """
    mse = quantity(calibration.mse_polished, measurement.mse_unit)
    return Figure(
        f"Measured and {calibration.final}: MSE {mse}",
        tuple(
            panel
            for output in range(len(measurement.output_names))
            for panel in (
                _outputs(measurement, calibration, output),
                _residuals(measurement, calibration, output),
            )
        ),
    )


def _outputs(measurement: MeasuredSeries, calibration: CalibrationRecord, output: int) -> Panel:
    axis, unit = time_axis(measurement.time)
    time, samples = unit.of_seconds(measurement.time), measurement.samples[output]
    dots = {"filled": True, "size": 14}
    series = [Series("measured", MEASURED, unit.of_seconds(samples.time), samples.values, "point", dots)]
    if not calibration.is_adaptive:
        series.append(Series("screened", SCREENED, time, calibration.y_screened[:, output]))
    series.append(Series(calibration.final, POLISHED, time, calibration.y_polished[:, output]))
    return Panel(measurement.output_names[output], axis, output_axis(measurement, output), series, 220)


def residual_reach(largest: float, uncertainty: float) -> float:
    """Return how far the axis of a residual reaches: a band much wider than it would make a line of it.

    Args:
        largest: The largest residual in size. [unit]
        uncertainty: The sensor's, infinite or NaN where it is not known. [unit]

    Returns:
        Above 0. [unit]
    """
    band = 1.25 * uncertainty if math.isfinite(uncertainty) else 0.0
    return max(1.12 * largest, band if not largest or band <= MOST_BAND * largest else 0.0) or 1.0


def _residuals(measurement: MeasuredSeries, calibration: CalibrationRecord, output: int) -> Panel:
    axis, time_unit = time_axis(measurement.time)
    unit = shortened(difference_unit(measurement.units[output]), 10)
    residual = measurement.residual(calibration.y_polished, output)
    uncertainty = float(measurement.uncertainty[output])
    largest = float(np.nanmax(np.abs(residual))) if np.isfinite(residual).any() else 0.0
    reach = residual_reach(largest, uncertainty)
    time, values = with_gaps(time_unit.of_seconds(measurement.samples[output].time), residual)
    series = [
        Series("zero", INK, y=[0.0], mark="rule", is_named=False),
        Series("residual", POLISHED, time, values, style={"strokeWidth": 1.3}, is_named=False),
    ]
    if math.isfinite(uncertainty) and uncertainty > 0:
        sensor = f"sensor ±{uncertainty:g} {unit}"
        series.insert(0, Series(sensor, TRAINING, low=[-uncertainty], high=[uncertainty], mark="rect"))
    scale = {"domain": [-reach, reach], "nice": False}
    name = f"residual of {measurement.output_names[output]}"
    return Panel(name, axis, Axis(axis_label("residual", unit), scale), series, 120)


def calls_figure(
    calibration: CalibrationRecord, references: Sequence[KnownError], *, mse_unit: str
) -> Figure:
    """Show the best MSE over counted model calls, those before the search shaded.

    These are the training set, of an adaptive one its first rows.

    Args:
        calibration: The calibration to show.
        references: Known MSEs, drawn as lines; may be empty.
        mse_unit: Unit of the MSE, e.g. "K²".
    """
    c, final = calibration, calibration.mse_polished
    calls, best = c.history_calls, c.history_mse
    n_before, what = c.n_train, "training set"
    if c.is_adaptive:
        n_before, what = int(calls[0]), "stored rows" if c.n_known else "first rows"
    last = max(c.calls_paper, int(calls.max(initial=0)), c.calls_to_polish + 1)
    first = 0.0 if c.is_adaptive else max(0.0, n_before - 0.6 * (last - n_before))
    before = f"{'← ' if first > 0 else ''}{what} ({count(n_before, 'call')})"
    series = [
        Series(before, TRAINING, [first], x_end=[n_before], mark="rect"),
        *reference_lines(references),
        *([] if c.is_adaptive else _gap(c)),
        Series(
            f"{quantity(final, mse_unit)} {c.final}", POLISHED, np.append(calls, last),
            np.append(best, np.fmin.reduce(best, initial=final)), style={"interpolate": "step-after"},
        ),
    ]  # fmt: skip
    x = Axis("model calls", {"domain": [first, last + 0.01 * (last - first)], "nice": False})
    panel = Panel("MSE", x, Axis(axis_label("best MSE", mse_unit), LOG), series, 260)
    total = count(c.calls_paper, "model call")
    return Figure(f"Best MSE over model calls: {quantity(final, mse_unit)} after {total}", (panel,))


def _gap(c: CalibrationRecord) -> list[Series]:
    """Return the MSE by the surrogate and by the model, both at the screened point, and the gap between."""
    ends, both = [c.n_train, c.calls_to_polish], [c.mse_surrogate, c.mse_screened]
    gap = Series("gap", FAINT, ends, both, style={"strokeWidth": 3}, is_named=False)
    return [
        *([gap] if math.isfinite(c.mse_screened) else []),
        Series("by the surrogate", SURROGATE, ends[:1], both[:1], "point", HOLLOW),
        Series("by the model, as screened", SCREENED, ends[1:], both[1:], "point", DIAMOND),
    ]
