"""Pictures of uncertainty: bands over time, and intervals of the parameters."""

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
    time_axis,
)
from studies.report.figures_calibration import output_axis
from studies.report.wording import axis_label, percent, shown_unit
from studies.stages.prediction import Prediction
from studies.stages.stage_results import Uncertainty

N_BINS = 40


def band_figure(case: Case, found: Uncertainty) -> Figure:
    """Show the bands of a posterior sample over the measurement.

    Args:
        case: What was calibrated, against what.
        found: The uncertainty.
    """
    axis, time_unit = time_axis(case.measurement.time)
    at, dots, panels = time_unit.of_seconds(case.measurement.time), {"filled": True, "size": 10}, []
    for k, (output, samples) in enumerate(zip(case.outputs, case.measurement.samples, strict=True)):
        series = _bands(at, found.predictive, found.simulated, k)
        times = time_unit.of_seconds(samples.time)
        series.append(Series("measured", MEASURED, times, samples.values, "point", dots))
        panels.append(Panel(output.name, axis, output_axis(case, k), series))
    return Figure(f"{percent(found.level)} bands of the outputs", tuple(panels))


def prediction_figure(found: Prediction) -> Figure:
    """Show each output of a calibrated model with other inputs over time, with its bands.

    Args:
        found: The prediction.
    """
    axis, time_unit = time_axis(found.time)
    at, panels = time_unit.of_seconds(found.time), []
    for k, (name, unit) in enumerate(zip(found.output_names, found.output_units, strict=True)):
        series = _bands(at, found.predictive, found.simulated, k)
        series.append(Series("calibrated", POLISHED, at, found.y[:, k]))
        panels.append(Panel(name, axis, Axis(axis_label(name, shown_unit(unit))), series))
    bands = "" if found.level is None else f", with {percent(found.level)} bands"
    return Figure(f"The calibrated model with other inputs{bands}", tuple(panels))


def _bands(
    at: FloatArray, predictive: FloatArray | None, simulated: FloatArray | None, k: int
) -> list[Series]:
    """Return the bands of an output, the wider one first.

    Args:
        at: Times, in the axis's unit. Shape (t,).
        predictive: Measured values to be expected, None without. Shape (2, t, k). [per output]
        simulated: Simulations of equally good parameter sets, None without. Shape (2, t, k). [per output]
        k: Place of the output.
    """
    return [
        Series(what, color, at, low=band[0, :, k], high=band[1, :, k])
        for what, color, band in (("with noise", TRAINING, predictive), ("simulated", SIMULATED, simulated))
        if band is not None
    ]


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
