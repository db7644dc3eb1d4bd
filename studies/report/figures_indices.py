"""The picture of Sobol indices over time as lines with confidence bands, first order above total order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from studies.report.drawing import FAINT, MUTED, SERIES, EndLabel, drawing, end_labels, time_axis
from studies.report.findings import mean_over_time, ranking
from studies.report.records import Floats, Integers
from studies.report.records_model import SensitivityRecord
from studies.report.wording import count, listed, percent

N_COLORED = 6


def indices_over_time_figure(sensitivity: SensitivityRecord, path: Path, *, footnote: str = "") -> Path:
    """Draw first- and total-order indices of the first output over time, with confidence bands (Fig. 5).

    Args:
        sensitivity: Sobol indices per time step.
        path: Where the PNG goes.
        footnote: Small print.

    Returns:
        The path.
    """
    order = ranking(sensitivity, 0)
    mean = mean_over_time(sensitivity.first_order[:, 0])
    names = listed(sensitivity.names[i] for i in order[:N_COLORED])
    share = float(np.nansum(mean[order[:N_COLORED]]))
    title = f"{names} alone explain {percent(share)} of the variance, averaged over time"
    with drawing(path, title=title, height_in=6.4, footnote=footnote) as figure:
        panels = figure.subplots(2, 1, sharex=True)
        first, total = sensitivity.first_order[:, 0], sensitivity.total_order[:, 0]
        _draw(panels[0], sensitivity, order, first, sensitivity.first_order_ci[:, 0])
        _draw(panels[1], sensitivity, order, total, sensitivity.total_order_ci[:, 0])
        panels[0].set_title("First order: what a parameter explains alone")
        panels[1].set_title("Total order: what it takes part in")
        panels[0].set_xlabel("")
    return path


def _draw(
    axes: Axes, sensitivity: SensitivityRecord, order: Integers, values: Floats, half_width: Floats
) -> None:
    time = time_axis(axes, sensitivity.time).of_seconds(sensitivity.time)
    labels = []
    # The most important last, so that it lies on top.
    for rank in reversed(range(len(order))):
        i = int(order[rank])
        color = SERIES[rank] if rank < N_COLORED else FAINT
        low, high = values[:, i] - half_width[:, i], values[:, i] + half_width[:, i]
        axes.fill_between(time, low, high, color=color, alpha=0.25, linewidth=0, zorder=2)
        axes.plot(time, values[:, i], color=color, linewidth=1.3 if rank < N_COLORED else 0.8, zorder=3)
        last = values[np.isfinite(values[:, i]), i]
        if rank < N_COLORED and last.size:
            labels.append(EndLabel(float(last[-1]), sensitivity.names[i], color))
    n_others = len(order) - N_COLORED
    if n_others > 0:
        labels.append(EndLabel(0.0, count(n_others, "other"), MUTED))
    top = float(np.nanmax(values + half_width)) if np.isfinite(values).any() else 1.0
    axes.set_ylim(min(0.0, -0.02 * top), 1.04 * top)
    axes.set_ylabel("share of the variance [1]")
    end_labels(axes, labels)
