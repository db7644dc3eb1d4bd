"""Pictures of calibrations: outputs over time, MSE over model calls, and all calibrations side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from simulation.case import KnownError
from studies.report.drawing import (
    FAINT,
    INK,
    MEASURED,
    POLISHED,
    SCREENED,
    SURROGATE,
    TRAINING,
    decimal_log,
    drawing,
    legend,
    line_with_gaps,
    mse_lines,
    shortened,
    time_axis,
)
from studies.report.records import CalibrationRecord, MeasuredSeries
from studies.report.wording import axis_label, count, difference_unit, quantity, shown_unit, squared

MOST_BAND = 3.0
"""The axis of a residual reaches the end of the sensor's band where that is at most so many times as far."""


def calibration_figure(
    measurement: MeasuredSeries, calibration: CalibrationRecord, path: Path, *, footnote: str = ""
) -> Path:
    """Draw measured, screened and final outputs over time, and the residual of the final below.

    Args:
        measurement: What it is compared with.
        calibration: The calibration to show.
        path: Where the PNG goes.
        footnote: Small print.

    Returns:
        The path.
    """
    n_outputs = len(measurement.output_names)
    mse_unit = squared(difference_unit(measurement.units[0]))
    title = f"Measured and {calibration.final}: MSE {quantity(calibration.mse_polished, mse_unit)}"
    with drawing(path, title=title, height_in=0.7 + 3.9 * n_outputs, footnote=footnote) as figure:
        panels = figure.subplots(
            2 * n_outputs, 1, sharex=True, height_ratios=[2.1, 1.0] * n_outputs, squeeze=False
        )
        for output in range(n_outputs):
            _draw_output(panels[2 * output, 0], measurement, calibration, output)
            _draw_residual(panels[2 * output + 1, 0], measurement, calibration, output)
        for axes in panels[:-1, 0]:
            axes.set_xlabel("")
    return path


def _draw_output(
    axes: Axes, measurement: MeasuredSeries, calibration: CalibrationRecord, output: int
) -> None:
    unit_of_time = time_axis(axes, measurement.time)
    simulated_at = unit_of_time.of_seconds(measurement.time)
    measured = measurement.samples[output]
    axes.plot(
        unit_of_time.of_seconds(measured.time), measured.values, linestyle="none", marker=".", markersize=5,
        color=MEASURED, zorder=2, label="measured",
    )  # fmt: skip
    if not calibration.is_adaptive:
        screened = calibration.y_screened[:, output]
        axes.plot(simulated_at, screened, color=SCREENED, linewidth=1.3, zorder=3, label="screened")
    final = calibration.y_polished[:, output]
    axes.plot(simulated_at, final, color=POLISHED, zorder=3, label=calibration.final)
    name, unit = measurement.output_names[output], measurement.units[output]
    axes.set_ylabel(axis_label(shortened(name), shortened(shown_unit(unit))))
    legend(axes)


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


def _draw_residual(
    axes: Axes, measurement: MeasuredSeries, calibration: CalibrationRecord, output: int
) -> None:
    unit_of_time = time_axis(axes, measurement.time)
    unit = shortened(difference_unit(measurement.units[output]), 10)
    residual = measurement.residual(calibration.y_polished, output)
    uncertainty = float(measurement.uncertainty[output])
    largest = float(np.nanmax(np.abs(residual))) if np.isfinite(residual).any() else 0.0
    reach = residual_reach(largest, uncertainty)
    axes.set_ylim(-reach, reach)
    if math.isfinite(uncertainty) and uncertainty > 0:
        axes.axhspan(
            -uncertainty, uncertainty, color=TRAINING, alpha=0.75, linewidth=0, zorder=0,
            label=f"sensor ±{uncertainty:g} {unit}",
        )  # fmt: skip
    axes.axhline(0.0, color=INK, linewidth=0.8)
    measured_at = unit_of_time.of_seconds(measurement.samples[output].time)
    line_with_gaps(axes, measured_at, residual, color=POLISHED, linewidth=1.1)
    axes.set_ylabel(axis_label("residual", unit))
    legend(axes)


def calls_figure(
    calibration: CalibrationRecord,
    references: Sequence[KnownError],
    path: Path,
    *,
    mse_unit: str,
    footnote: str = "",
) -> Path:
    """Draw the best MSE over counted model calls, those before the search shaded.

    These are the training set, of an adaptive one its first rows.

    Args:
        calibration: The calibration to show.
        references: Known MSEs, drawn as lines; may be empty.
        path: Where the PNG goes.
        mse_unit: Unit of the MSE, e.g. "K²".
        footnote: Small print.

    Returns:
        The path.
    """
    c, final = calibration, calibration.mse_polished
    calls, best = c.history_calls, c.history_mse
    total = count(c.calls_paper, "model call")
    title = f"Best MSE over model calls: {quantity(final, mse_unit)} after {total}"
    n_before, what = c.n_train, "training set"
    if c.is_adaptive:
        n_before, what = int(calls[0]), "stored rows" if c.n_known else "first rows"
    last = max(c.calls_paper, int(calls.max(initial=0)), c.calls_to_polish + 1)
    first = 0.0 if c.is_adaptive else max(0.0, n_before - 0.6 * (last - n_before))
    with drawing(path, title=title, height_in=3.7, footnote=footnote) as figure:
        axes = figure.subplots()
        axes.set_xlim(first, last + 0.01 * (last - first))
        decimal_log(axes)
        label = f"{'← ' if first > 0 else ''}{what} ({count(n_before, 'call')})"
        axes.axvspan(first, n_before, color=TRAINING, linewidth=0, zorder=0, label=label)
        mse_lines(axes, references)
        if not c.is_adaptive:
            _draw_gap(axes, [n_before, c.calls_to_polish], c)
        ends = np.fmin.reduce(best, initial=final)
        axes.step(
            np.append(calls, last), np.append(best, ends), where="post", color=POLISHED, zorder=3,
            label=f"{quantity(final, mse_unit)} {c.final}",
        )  # fmt: skip
        axes.set_xlabel("model calls")
        axes.set_ylabel(axis_label("best MSE", mse_unit))
        legend(axes)
    return path


def _draw_gap(axes: Axes, places: Sequence[float], c: CalibrationRecord) -> None:
    """Mark the MSE by the surrogate and by the model, both at the screened point, and the gap between."""
    at_surrogate, at_model = places
    if math.isfinite(c.mse_screened):
        axes.plot(places, [c.mse_surrogate, c.mse_screened], color=FAINT, linewidth=2.5, zorder=1)
        axes.plot(
            at_model, c.mse_screened, linestyle="none", marker="D", markersize=6, color=SCREENED, zorder=5,
            label="by the model, as screened",
        )  # fmt: skip
    axes.plot(
        at_surrogate, c.mse_surrogate, linestyle="none", marker="o", markersize=7, color="white",
        markeredgecolor=SURROGATE, zorder=5, label="by the surrogate",
    )  # fmt: skip
