"""Pictures of the model: does a simulated set cover the measurement (Fig. 4), Sobol indices (Fig. 5)."""

import math

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.measurement import Measurement
from studies.report.drawing import (
    INK,
    SERIES,
    SIMULATED,
    TRAINING,
    Axis,
    Figure,
    Panel,
    Series,
    shortened,
    time_axis,
    with_gaps,
)
from studies.report.figures_calibration import limit_lines, output_axis
from studies.report.wording import count, percent
from studies.sobol import SobolIndices

N_SHOWN = 6
"""Parameters whose indices over time are shown, the largest; the table has all."""


def coverage_figure(case: Case, y: FloatArray) -> Figure:
    """Show where the trajectories of the training set lie, with the measurement over them (Fig. 4).

    Args:
        case: What is to be covered.
        y: The trajectories; failed rows, which are NaN, are left out. Shape (n, t, k). [per output]
    """
    good, measurement = without_failed(y), case.measurement
    axis, unit = time_axis(measurement.time)
    time, panels = unit.of_seconds(measurement.time), []
    for k, name in enumerate(measurement.output_names):
        samples, series = measurement.samples[k], limit_lines(measurement, k)
        if k in measurement.measured:
            at, values = with_gaps(unit.of_seconds(samples.time), samples.values)
            series.append(Series("measured", INK, at, values))
        if len(good):
            low, quarter, three_quarters, high = np.quantile(good[:, :, k], [0.0, 0.25, 0.75, 1.0], axis=0)
            series = [
                Series("lowest to highest", TRAINING, time, low=low, high=high),
                Series("half of the simulations", SIMULATED, time, low=quarter, high=three_quarters),
                *series,
            ]
        panels.append(Panel(name, axis, output_axis(case, k), series, 240))
    title = f"The measurement and {count(len(good), 'simulation')} of the training set"
    return Figure(title, tuple(panels))


def coverage_caption(case: Case, y: FloatArray) -> str:
    """Say whether the trajectories of `coverage_figure` could have produced the measurement."""
    good = without_failed(y)
    n_failed = len(y) - len(good)
    failed = f" {count(n_failed, 'simulation')} failed." if n_failed else ""
    share = percent(enclosed_fraction(case.measurement, good))
    return f"{share} of the measured values lie between the lowest and the highest simulated one.{failed}"


def without_failed(y: FloatArray) -> FloatArray:
    """Return the trajectories that hold no NaN. Shape (n_good, t, k). [per output]."""
    return y[np.isfinite(y).all(axis=(1, 2))]


def enclosed_fraction(measurement: Measurement, y: FloatArray) -> float:
    """Return the fraction of measured values between the lowest and the highest simulated at their time. [1].

    Args:
        measurement: What was measured.
        y: Trajectories without failed ones. Shape (n, t, k). [units]
    """
    if not len(y):
        return math.nan
    differences = [measurement.differences(y, k) for k in measurement.measured]
    inside = [(above.min(axis=0) <= 0.0) & (above.max(axis=0) >= 0.0) for above in differences]
    return float(np.mean(np.concatenate(inside)))


def sensitivity_figure(sensitivity: SobolIndices) -> Figure:
    """Show the largest first- and total-order indices of every output over time, with their intervals.

    Args:
        sensitivity: Sobol indices per time step.
    """
    s = sensitivity
    axis, unit = time_axis(s.time)
    time, panels = unit.of_seconds(s.time), []
    for k, output in enumerate(s.output_names):
        for kind, all_values, all_halves in (
            ("First order", s.first_order, s.first_order_ci),
            ("Total order", s.total_order, s.total_order_ci),
        ):
            series = []
            for rank, i in enumerate(s.order(k)[:N_SHOWN]):
                value, half = all_values[:, k, i], all_halves[:, k, i]
                series.append(
                    Series(
                        shortened(s.names[i]), SERIES[rank], time, value, low=value - half, high=value + half
                    )
                )
            n_undefined = int(np.sum(~np.isfinite(all_values[:, k]).all(axis=1)))
            undefined = f"; undefined at {count(n_undefined, 'time step')}" if n_undefined else ""
            name = f"{kind}, {shortened(output)}{undefined}"
            panels.append(Panel(name, axis, Axis("share of the variance [1]"), series))
    return Figure("Sobol indices over time", tuple(panels), shows_names=True)
