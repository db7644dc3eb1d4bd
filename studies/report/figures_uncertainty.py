"""Pictures of uncertainty: bands over the measurement, and intervals of the parameters."""

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
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
from studies.report.wording import axis_label, difference_unit, percent
from studies.stages.stage_results import Uncertainty

N_BINS = 40


def band_figure(case: Case, found: Uncertainty) -> Figure:
    """Show the bands of a posterior sample over the measurement, and below around their middle.

    Args:
        case: What was calibrated, against what.
        found: The uncertainty.
    """
    places = range(len(case.outputs))
    panels = [_bands(case, found, k, is_around_middle=around) for k in places for around in (False, True)]
    return Figure(f"{percent(found.level)} bands of the outputs", tuple(panels))


def _bands(case: Case, found: Uncertainty, k: int, *, is_around_middle: bool) -> Panel:
    measurement = case.measurement
    axis, time_unit = time_axis(measurement.time)
    middle, samples = found.simulated.mean(axis=0), measurement.samples[k]
    name, y, color, height = case.outputs[k].name, output_axis(case, k), MEASURED, 200
    base, values = np.zeros(len(middle)), samples.values
    if is_around_middle:
        name, color, height = f"{name} around the middle", INK, 160
        base, values = middle[:, k], -measurement.differences(middle[None], k)[0]
        unit = shortened(difference_unit(case.outputs[k].unit), 10)
        y = Axis(axis_label("around the middle", unit))
    at, series = time_unit.of_seconds(measurement.time), []
    for band, shade, what in (
        (found.predictive, TRAINING, "with noise"),
        (found.simulated, SIMULATED, "simulated"),
    ):
        low, high = band[:, :, k] - base
        series.append(Series(what, shade, at, low=low, high=high))
    times, dots = time_unit.of_seconds(samples.time), {"filled": True, "size": 10}
    is_named = not is_around_middle
    series.append(Series("measured", color, times, values, "point", dots, is_named=is_named))
    return Panel(name, axis, y, series, height, has_legend=is_named)


def interval_figure(box: ParameterSpace, found: Uncertainty) -> Figure:
    """Show density and interval of every parameter between its bounds.

    Args:
        box: The parameters.
        found: The uncertainty.
    """
    names = list(found.parameters)
    linear_low, linear_high = box.to_unit(found.linear)
    point, dot = box.to_unit(found.point), {"filled": True, "size": 30}
    series = [
        Series("linearised", SCREENED, linear_low, names, "rule", {"yOffset": 5}, x_end=linear_high),
        Series("calibrated", INK, point, names, "point", dot),
    ]
    if found.sample.is_trusted:
        low, high = box.to_unit(found.interval)
        what, thick = f"{percent(found.level)} interval", {"strokeWidth": 4}
        interval = Series(what, POLISHED, low, names, "rule", thick, x_end=high)
        series = [_density(box, found.particles_theta, names), interval, *series]
    x = Axis("from the lower to the upper bound [1]", BETWEEN_BOUNDS)
    panel = Panel("parameters", x, Axis("", is_of_names=True), series, 26 * len(names))
    return Figure("Intervals of the parameters between their bounds", (panel,))


def _density(box: ParameterSpace, particles: FloatArray, names: list[str]) -> Series:
    """Return how the sample of each parameter is spread, as rectangles that are darker where it is denser."""
    u, edges = box.to_unit(particles), np.linspace(0.0, 1.0, N_BINS + 1)
    counts = np.stack([np.histogram(column, edges)[0] for column in u.T])
    shares = 0.9 * counts / np.maximum(counts.max(axis=1, keepdims=True), 1)
    p = len(names)
    return Series(
        "density", SIMULATED, np.tile(edges[:-1], p), np.repeat(names, N_BINS), "rect", {},
        x_end=np.tile(edges[1:], p), share=shares.ravel(),
    )  # fmt: skip
