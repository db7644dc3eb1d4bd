"""Pictures of uncertainty: bands over the measurement, intervals of parameters, pairs that compensate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from simulation.parameters import ParameterSpace
from studies.report.drawing import (
    INK,
    MEASURED,
    POLISHED,
    SCREENED,
    SIMULATED,
    TRAINING,
    drawing,
    legend,
    shortened,
    time_axis,
)
from studies.report.records import MeasuredSeries
from studies.report.uncertainty import UncertaintyRecord
from studies.report.wording import (
    axis_label,
    difference_unit,
    digits_between,
    percent,
    shown_unit,
    significant,
)

N_BINS = 40


def band_figure(
    measured: MeasuredSeries, record: UncertaintyRecord, path: Path, *, footnote: str = ""
) -> Path:
    """Draw the bands of a posterior sample over the measurement, and below around their middle.

    Args:
        measured: What was calibrated against.
        record: The uncertainty.
        path: Where the PNG goes.
        footnote: Small print.

    Returns:
        The path.
    """
    n_outputs = len(measured.output_names)
    title = f"{percent(record.level)} bands of the outputs"
    with drawing(path, title=title, height_in=0.7 + 3.9 * n_outputs, footnote=footnote) as figure:
        panels = figure.subplots(
            2 * n_outputs, 1, sharex=True, height_ratios=[1.6, 1.2] * n_outputs, squeeze=False
        )
        for k in range(n_outputs):
            _draw_band(panels[2 * k, 0], measured, record, k, is_around_middle=False)
            _draw_band(panels[2 * k + 1, 0], measured, record, k, is_around_middle=True)
        for axes in panels[:-1, 0]:
            axes.set_xlabel("")
    return path


def _draw_band(
    axes: Axes, measured: MeasuredSeries, record: UncertaintyRecord, k: int, *, is_around_middle: bool
) -> None:
    unit_of_time = time_axis(axes, measured.time)
    at = unit_of_time.of_seconds(measured.time)
    middle = record.simulated[:, :, k].mean(axis=0)
    base = middle if is_around_middle else np.zeros_like(middle)
    samples = measured.samples[k]
    values = samples.values
    if is_around_middle:
        trajectory = np.repeat(middle[:, None], len(measured.output_names), axis=1)
        values = -measured.residual(trajectory, k)
    for band, color, what in (
        (record.predictive, TRAINING, "with noise"),
        (record.simulated, SIMULATED, "simulated"),
    ):
        low, high = band[:, :, k] - base
        axes.fill_between(at, low, high, color=color, linewidth=0, label=what)
    axes.plot(
        unit_of_time.of_seconds(samples.time), values, linestyle="none", marker=".", markersize=3.5,
        color=MEASURED if not is_around_middle else INK, alpha=0.8, zorder=3, label="measured",
    )  # fmt: skip
    name, unit = measured.output_names[k], measured.units[k]
    if is_around_middle:
        axes.set_ylabel(axis_label("around the middle", shortened(difference_unit(unit), 10)))
    else:
        axes.set_ylabel(axis_label(shortened(name), shortened(shown_unit(unit))))
        legend(axes)


def interval_figure(
    box: ParameterSpace, record: UncertaintyRecord, path: Path, *, footnote: str = ""
) -> Path:
    """Draw density and interval of every parameter between its bounds.

    Args:
        box: The parameters.
        record: The uncertainty.
        path: Where the PNG goes.
        footnote: Small print.

    Returns:
        The path.
    """
    p = len(record.names)
    title = "Intervals of the parameters between their bounds"
    u, point = box.to_unit(record.particles), box.to_unit(record.calibrated)
    low, high = box.to_unit(record.interval)
    linear_low, linear_high = box.to_unit(record.linear)
    with drawing(path, title=title, height_in=0.9 + 0.42 * p, footnote=footnote) as figure:
        axes = figure.subplots()
        for j in range(p):
            axes.plot(
                [linear_low[j], linear_high[j]], [j + 0.13] * 2, color=SCREENED, linewidth=1.2, zorder=3
            )
            axes.plot([point[j]], [j], marker="o", markersize=4.5, color=INK, zorder=4, clip_on=False)
            if not record.is_trusted:
                continue
            density, edges = np.histogram(u[:, j], bins=N_BINS, range=(0.0, 1.0))
            heights = 0.78 * density / max(density.max(), 1)
            axes.stairs(j - heights, edges, baseline=j, fill=True, color=TRAINING, zorder=1)
            axes.plot([low[j], high[j]], [j, j], color=POLISHED, linewidth=4.0, zorder=3)
        axes.set_yticks(range(p), [shortened(name, 14) for name in record.names])
        axes.tick_params(axis="y", length=0)
        axes.grid(visible=False, axis="y")
        axes.set_ylim(p - 0.6, -1.0)
        axes.set_xlim(0.0, 1.0)
        axes.set_xticks([0.0, 0.5, 1.0], ["lower bound", "", "upper bound"])
        if record.is_trusted:
            axes.plot([], color=POLISHED, linewidth=4.0, label=f"{percent(record.level)} interval")
        axes.plot([], color=SCREENED, linewidth=1.2, label="linearised")
        axes.plot([], color=INK, linestyle="none", marker="o", markersize=4.5, label="calibrated")
        axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
        right = axes.secondary_yaxis("right")
        units = (shown_unit(one.unit) for one in box.parameters)
        shown = record.interval if record.is_trusted else record.linear
        right.set_yticks(
            range(p),
            [
                f"{_short(a, b)} to {_short(b, a)} {unit}".strip()
                for (a, b), unit in zip(shown.T, units, strict=True)
            ],
            fontsize=8,
        )
        right.tick_params(axis="y", length=0, pad=8)
        right.spines["right"].set_visible(False)
    return path


def _short(value: float, other: float) -> str:
    """Write three digits, e.g. 150,000, and more only where the other end of an interval is near."""
    digits = digits_between(value, other)
    return significant(float(f"{value:.{digits}g}"), digits)
