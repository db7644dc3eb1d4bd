"""The picture of Sobol indices over time with confidence bands, first order above total (Fig. 5)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from studies.report.drawing import FAINT, SERIES, drawing, legend, shortened, time_axis
from studies.report.records import Floats
from studies.report.wording import count
from studies.sensitivity import SobolIndices

N_COLORED = 6


def sensitivity_figure(sensitivity: SobolIndices, path: Path, *, footnote: str = "") -> Path:
    """Draw first- and total-order indices of every output over time.

    Args:
        sensitivity: Sobol indices per time step.
        path: Where the PNG goes.
        footnote: Small print.

    Returns:
        The path.
    """
    s = sensitivity
    height = 0.7 + 5.6 * len(s.output_names)
    with drawing(path, title="Sobol indices over time", height_in=height, footnote=footnote) as figure:
        panels = figure.subplots(2 * len(s.output_names), 1, sharex=True)
        for k, output in enumerate(s.output_names):
            first, total = panels[2 * k : 2 * k + 2]
            first.set_title(f"First order: what a parameter explains of {shortened(output)} alone")
            _draw(first, s, k, s.first_order[:, k], s.first_order_ci[:, k])
            legend(first)
            total.set_title(f"Total order: what it takes part in of {shortened(output)}")
            _draw(total, s, k, s.total_order[:, k], s.total_order_ci[:, k])
        for axes in panels[:-1]:
            axes.set_xlabel("")
    return path


def _draw(axes: Axes, s: SobolIndices, output: int, values: Floats, half_width: Floats) -> None:
    """Draw one kind of indices of an output. Shapes (t, p)."""
    time = time_axis(axes, s.time).of_seconds(s.time)
    order = s.order(output)
    for rank, i in enumerate(order):
        color = SERIES[rank] if rank < N_COLORED else FAINT
        name = shortened(s.names[i]) if rank < N_COLORED else None
        if rank == N_COLORED:
            name = count(len(order) - N_COLORED, "other")
        low, high = values[:, i] - half_width[:, i], values[:, i] + half_width[:, i]
        # The most important lies on top.
        layer = 3.0 - rank / len(order)
        axes.fill_between(time, low, high, color=color, alpha=0.25, linewidth=0, zorder=layer - 1.0)
        axes.plot(
            time, values[:, i], color=color, linewidth=1.3 if rank < N_COLORED else 0.8, zorder=layer,
            label=name,
        )  # fmt: skip
    n_undefined = int(np.sum(~np.isfinite(values).all(axis=1)))
    undefined = f"; undefined at {count(n_undefined, 'time step')}" if n_undefined else ""
    axes.set_ylim(bottom=min(0.0, axes.get_ylim()[0]))
    axes.set_ylabel("share of the variance [1]")
    axes.set_title(axes.get_title(loc="left") + undefined)
