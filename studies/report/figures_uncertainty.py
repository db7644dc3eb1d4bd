"""Pictures of uncertainty: bands over the measurement, and intervals of the parameters."""

from __future__ import annotations

import numpy as np

from simulation.parameters import ParameterSpace
from studies.report.drawing import (
    BETWEEN_BOUNDS,
    INK,
    MEASURED,
    POLISHED,
    SCREENED,
    SIMULATED,
    TRAINING,
    Axis,
    Figure,
    Panel,
    Series,
    shortened,
    time_axis,
)
from studies.report.figures_calibration import output_axis
from studies.report.records import MeasuredSeries
from studies.report.uncertainty_record import UncertaintyRecord
from studies.report.wording import axis_label, difference_unit, percent

N_BINS = 40


def band_figure(measured: MeasuredSeries, record: UncertaintyRecord) -> Figure:
    """Show the bands of a posterior sample over the measurement, and below around their middle.

    Args:
        measured: What was calibrated against.
        record: The uncertainty.
    """
    panels = [
        _bands(measured, record, k, is_around_middle=around)
        for k in range(len(measured.output_names))
        for around in (False, True)
    ]
    return Figure(f"{percent(record.level)} bands of the outputs", tuple(panels))


def _bands(measured: MeasuredSeries, record: UncertaintyRecord, k: int, *, is_around_middle: bool) -> Panel:
    axis, time_unit = time_axis(measured.time)
    middle, samples, name = (
        record.simulated[:, :, k].mean(axis=0),
        measured.samples[k],
        measured.output_names[k],
    )
    base, values, y = np.zeros_like(middle), samples.values, output_axis(measured, k)
    if is_around_middle:
        trajectory = np.repeat(middle[:, None], len(measured.output_names), axis=1)
        base, values = middle, -measured.residual(trajectory, k)
        y = Axis(axis_label("around the middle", shortened(difference_unit(measured.units[k]), 10)))
    series = []
    for band, color, what in (
        (record.predictive, TRAINING, "with noise"),
        (record.simulated, SIMULATED, "simulated"),
    ):
        low, high = band[:, :, k] - base
        at = time_unit.of_seconds(measured.time)
        series.append(Series(what, color, at, low=low, high=high))
    color, dots = INK if is_around_middle else MEASURED, {"filled": True, "size": 10}
    series.append(
        Series(
            "measured",
            color,
            time_unit.of_seconds(samples.time),
            values,
            "point",
            dots,
            is_named=not is_around_middle,
        )
    )
    panel_name = f"{name} around the middle" if is_around_middle else name
    return Panel(
        panel_name, axis, y, series, 160 if is_around_middle else 200, has_legend=not is_around_middle
    )


def interval_figure(box: ParameterSpace, record: UncertaintyRecord) -> Figure:
    """Show density and interval of every parameter between its bounds.

    Args:
        box: The parameters.
        record: The uncertainty.
    """
    names = list(record.names)
    low, high = box.to_unit(record.interval)
    linear_low, linear_high = box.to_unit(record.linear)
    series = [
        Series("linearised", SCREENED, linear_low, names, "rule", {"yOffset": 5}, x_end=linear_high),
        Series(
            "calibrated", INK, box.to_unit(record.calibrated), names, "point", {"filled": True, "size": 30}
        ),
    ]
    if record.is_trusted:
        thick = {"strokeWidth": 4}
        interval = Series(
            f"{percent(record.level)} interval", POLISHED, low, names, "rule", thick, x_end=high
        )
        series = [_density(box, record, names), interval, *series]
    x = Axis("from the lower to the upper bound [1]", BETWEEN_BOUNDS)
    panel = Panel("parameters", x, Axis("", is_of_names=True), series, 26 * len(names))
    return Figure("Intervals of the parameters between their bounds", (panel,))


def _density(box: ParameterSpace, record: UncertaintyRecord, names: list[str]) -> Series:
    """Return how the sample of each parameter is spread, as rectangles that are darker where it is denser."""
    u, edges = box.to_unit(record.particles), np.linspace(0.0, 1.0, N_BINS + 1)
    counts = np.stack([np.histogram(column, edges)[0] for column in u.T])
    shares = 0.9 * counts / np.maximum(counts.max(axis=1, keepdims=True), 1)
    p = len(names)
    return Series(
        "density", SIMULATED, np.tile(edges[:-1], p), np.repeat(names, N_BINS), "rect", {},
        x_end=np.tile(edges[1:], p), share=shares.ravel(),
    )  # fmt: skip
