"""Pictures of one calibration: temperatures over time, and MSE over model calls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from studies.report.captions import calibration_title
from studies.report.data import Reference
from studies.report.drawing import (
    FAINT,
    INK,
    MEASURED,
    MUTED,
    POLISHED,
    SCREENED,
    SURROGATE,
    TRAINING,
    EndLabel,
    decimal_log,
    drawing,
    end_labels,
    line_with_gaps,
    log_limits,
    shortened,
    time_axis,
)
from studies.report.findings import last_finite
from studies.report.records import CalibrationRecord, MeasuredSeries
from studies.report.wording import (
    axis_label,
    count,
    difference_unit,
    quantity,
    shown_unit,
    significant,
)

MOST_BAND = 3.0
"""The axis of a residual reaches the end of the sensor's band where that is at most so many times as far."""


def calibration_figure(
    measurement: MeasuredSeries,
    calibration: CalibrationRecord,
    path: Path,
    *,
    title: str = "",
    footnote: str = "",
) -> Path:
    """Draw measured, screened and final outputs over time, and the residual of the final below.

    Args:
        measurement: What was calibrated against.
        calibration: The calibration to show.
        path: Where the PNG goes.
        title: What it shows; "" says how well the calibration went.
        footnote: Small print.

    Returns:
        The path.
    """
    n_outputs = len(measurement.output_names)
    title = title or calibration_title(measurement, calibration)
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
    series = (
        ("screened", calibration.y_screened[:, output], SCREENED, 1.3),
        (calibration.final, calibration.y_polished[:, output], POLISHED, 1.6),
    )[calibration.is_adaptive :]
    measured = measurement.samples[output]
    measured_at = unit_of_time.of_seconds(measured.time)
    axes.plot(
        measured_at, measured.values, linestyle="none", marker=".", markersize=5, color=MEASURED, zorder=2
    )
    labels = [EndLabel(last_finite(measured.values), "measured", INK)]
    for name, values, color, width in series:
        axes.plot(simulated_at, values, color=color, linewidth=width, zorder=3)
        labels.append(EndLabel(last_finite(values), name, color))
    name, unit = measurement.output_names[output], measurement.units[output]
    axes.set_ylabel(axis_label(shortened(name), shortened(shown_unit(unit))))
    axes.set_ylim(*axes.get_ylim())
    end_labels(axes, labels)


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
    unit = difference_unit(measurement.units[output])
    residual = measurement.residual(calibration.y_polished, output)
    uncertainty = float(measurement.uncertainty[output])
    largest = float(np.nanmax(np.abs(residual))) if np.isfinite(residual).any() else 0.0
    reach = residual_reach(largest, uncertainty)
    axes.set_ylim(-reach, reach)
    labels = []
    if math.isfinite(uncertainty) and uncertainty > 0:
        axes.axhspan(-uncertainty, uncertainty, color=TRAINING, alpha=0.75, linewidth=0, zorder=0)
        labels.append(EndLabel(min(uncertainty, reach), f"sensor\n±{uncertainty:g} {unit}", MUTED))
    axes.axhline(0.0, color=INK, linewidth=0.8)
    measured_at = unit_of_time.of_seconds(measurement.samples[output].time)
    line_with_gaps(axes, measured_at, residual, color=POLISHED, linewidth=1.1)
    labels.append(EndLabel(last_finite(residual), calibration.final, POLISHED))
    axes.set_ylabel(axis_label("residual", shortened(unit, 10)))
    end_labels(axes, labels)


def polish_figure(
    calibration: CalibrationRecord,
    references: Sequence[Reference],
    path: Path,
    *,
    mse_unit: str,
    footnote: str = "",
) -> Path:
    """Draw the best MSE over counted model calls: the training set shaded, the screening check marked.

    Args:
        calibration: The calibration to show.
        references: Known MSEs, drawn as lines; may be empty.
        path: Where the PNG goes.
        mse_unit: Unit of the MSE, e.g. "K²".
        footnote: Small print.

    Returns:
        The path.
    """
    screened, final = calibration.mse_screened, calibration.mse_polished
    calls, total = count(calibration.n_polish, "call"), count(calibration.calls_paper)
    if math.isinf(screened) and math.isfinite(final):
        reached = quantity(final, mse_unit)
        title = f"From a point that failed, {calls} of polishing reach {reached}; {total} in all"
    elif final < screened:
        title = (
            f"{calls} of polishing take the MSE from {quantity(screened, mse_unit)} "
            f"to {quantity(final, mse_unit)}; {total} in all"
        )
    else:
        title = f"{calls} of polishing do not improve the screened point (MSE {quantity(screened, mse_unit)})"
    n_screened, n_check = calibration.calls_to_screen, calibration.calls_to_polish
    last = max(calibration.calls_paper, int(calibration.history_calls.max(initial=0)), n_check + 1)
    first = max(0.0, n_screened - 0.6 * (last - n_screened))
    known = [final, screened, calibration.mse_surrogate, *(r.mse for r in references)]
    with drawing(path, title=title, height_in=3.7, footnote=footnote) as figure:
        axes = figure.subplots()
        axes.set_xlim(first, last + 0.01 * (last - first))
        decimal_log(axes, *log_limits(np.concatenate([calibration.history_mse, np.array(known)])))
        _shade_training(axes, calibration, first)
        for reference in references:
            axes.axhline(reference.mse, color=MUTED, linewidth=0.9, linestyle=(0, (5, 3)), zorder=1)
        _draw_promise(axes, calibration, mse_unit)
        calls_drawn = np.append(calibration.history_calls, last)
        best = np.append(calibration.history_mse, np.fmin.reduce(calibration.history_mse, initial=final))
        axes.step(calls_drawn, best, where="post", color=POLISHED, zorder=3)
        relevance = "relevance + " if calibration.n_before else ""
        axes.set_xlabel(f"model calls ({relevance}training + screening check + polish)")
        axes.set_ylabel(axis_label("best MSE", mse_unit))
        labels = [EndLabel(final, f"{significant(final)} polished", POLISHED)]
        labels += [EndLabel(r.mse, f"{significant(r.mse)} {r.label}", MUTED) for r in references]
        end_labels(axes, labels)
    return path


def _shade_training(axes: Axes, calibration: CalibrationRecord, first: float) -> None:
    axes.axvspan(first, calibration.calls_to_screen, color=TRAINING, linewidth=0, zorder=0)
    arrow = "← " if first > 0 else ""
    before = f",\n{count(calibration.n_before)} for\nrelevance" if calibration.n_before else ""
    axes.annotate(
        f"{arrow}{count(calibration.n_train)}\ntraining\nsimulations{before}",
        xy=(first, 0.97),
        xycoords=("data", "axes fraction"),
        xytext=(6, 0),
        textcoords="offset points",
        va="top",
        fontsize=8.5,
        color=MUTED,
    )


def _draw_promise(axes: Axes, calibration: CalibrationRecord, mse_unit: str) -> None:
    """Mark what the surrogate promised, what the physical model answered, and the gap between."""
    n_screened, n_check = calibration.calls_to_screen, calibration.calls_to_polish
    promise, answer = calibration.mse_surrogate, calibration.mse_screened
    if math.isfinite(answer):
        axes.plot([n_screened, n_check], [promise, answer], color=FAINT, linewidth=1.2, zorder=1)
        axes.plot([n_check], [answer], marker="D", markersize=6, color=SCREENED, zorder=5)
        text, height = f"screening check {quantity(answer, mse_unit)}", answer
    else:
        text, height = "screening check: simulation failed", axes.get_ylim()[1]
    axes.annotate(
        text, (n_check, height), (8, 3), textcoords="offset points", fontsize=8.5, color=SCREENED, va="bottom"
    )
    axes.plot(
        [n_screened], [promise], marker="o", markersize=6, color="white", markeredgecolor=SURROGATE, zorder=5
    )
    axes.annotate(
        f"promised by the\nsurrogate {significant(promise)}",
        (n_screened, promise),
        (-8, 0),
        textcoords="offset points",
        fontsize=8.5,
        color=SURROGATE,
        ha="right",
        va="center",
        bbox={"facecolor": TRAINING, "edgecolor": "none", "pad": 1.0},
    )
