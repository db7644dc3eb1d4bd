"""The picture of a simulated set: does it cover the measurement (Fig. 4)?"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from studies.report.drawing import INK, SIMULATED, drawing, legend, line_with_gaps, shortened, time_axis
from studies.report.findings import good_rows
from studies.report.records import CoverageSet, MeasuredSeries
from studies.report.wording import axis_label, count, shown_unit


def coverage_figure(
    measurement: MeasuredSeries, coverage: CoverageSet, path: Path, *, footnote: str = ""
) -> Path:
    """Draw all trajectories of a set with the measurement over them (Fig. 4 of the paper).

    Args:
        measurement: What is to be covered.
        coverage: The simulated set; failed rows are left out.
        path: Where the PNG goes.
        footnote: Small print.

    Returns:
        The path.
    """
    good = good_rows(coverage)
    n_outputs = len(measurement.output_names)
    title = f"The measurement and {count(len(good), 'simulation')} of the {coverage.name} set"
    with drawing(path, title=title, height_in=0.6 + 3.2 * n_outputs, footnote=footnote) as figure:
        panels = figure.subplots(n_outputs, 1, sharex=True, squeeze=False)
        for output in range(n_outputs):
            axes = panels[output, 0]
            unit_of_time = time_axis(axes, measurement.time)
            alpha = float(np.clip(60.0 / max(len(good), 1), 0.07, 0.6))
            if len(good):
                axes.plot(
                    unit_of_time.of_seconds(measurement.time), good[:, :, output].T, color=SIMULATED,
                    linewidth=0.8, alpha=alpha, label=["simulated", *[None] * (len(good) - 1)],
                )  # fmt: skip
            measured = measurement.samples[output]
            measured_at = unit_of_time.of_seconds(measured.time)
            line_with_gaps(axes, measured_at, measured.values, color="white", linewidth=3.6, zorder=4)
            line_with_gaps(
                axes, measured_at, measured.values, color=INK, linewidth=1.8, zorder=5, label="measured"
            )
            name, unit = measurement.output_names[output], shown_unit(measurement.units[output])
            axes.set_ylabel(axis_label(shortened(name), shortened(unit)))
            legend(axes)
        for axes in panels[:-1, 0]:
            axes.set_xlabel("")
    return path
