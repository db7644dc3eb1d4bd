"""Pictures of the model: does a simulated set cover the measurement (Fig. 4), Sobol indices (Fig. 5)."""

from __future__ import annotations

import numpy as np

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
from studies.report.figures_calibration import output_axis
from studies.report.records import CoverageSet, MeasuredSeries
from studies.report.wording import count
from studies.sobol import SobolIndices

N_SHOWN = 6
"""Parameters whose indices over time are shown, the largest; the table has all."""


def coverage_figure(measurement: MeasuredSeries, coverage: CoverageSet) -> Figure:
    """Show where the trajectories of a set lie, with the measurement over them (Fig. 4 of the paper).

    Args:
        measurement: What is to be covered.
        coverage: The simulated set; failed rows are left out.
    """
    good = coverage.good
    axis, unit = time_axis(measurement.time)
    time, panels = unit.of_seconds(measurement.time), []
    for k, name in enumerate(measurement.output_names):
        samples = measurement.samples[k]
        at, values = with_gaps(unit.of_seconds(samples.time), samples.values)
        series = [Series("measured", INK, at, values)]
        if len(good):
            low, quarter, three_quarters, high = np.quantile(good[:, :, k], [0.0, 0.25, 0.75, 1.0], axis=0)
            series = [
                Series("lowest to highest", TRAINING, time, low=low, high=high),
                Series("half of the simulations", SIMULATED, time, low=quarter, high=three_quarters),
                *series,
            ]
        panels.append(Panel(name, axis, output_axis(measurement, k), series, 240))
    title = f"The measurement and {count(len(good), 'simulation')} of the {coverage.name} set"
    return Figure(title, tuple(panels))


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
