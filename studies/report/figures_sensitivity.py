"""The picture of Sobol indices over time (Fig. 5 of the paper), with total-order indices beside."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from studies.report.drawing import (
    FAINT,
    INK,
    MUTED,
    SERIES,
    EndLabel,
    drawing,
    end_labels,
    shortened,
    time_axis,
)
from studies.report.findings import mean_over_time, ranking
from studies.report.records import Integers
from studies.report.records_model import SensitivityRecord
from studies.report.wording import count, listed, percent

N_LABELED = 6
LEAST_NAMED = 0.005
"""Share of the variance from which on a title names a parameter beside the first one. [1]"""


def sensitivity_figure(sensitivity: SensitivityRecord, path: Path, *, footnote: str = "") -> Path:
    """Draw first-order indices stacked over time, and total-order indices with confidence intervals beside.

    Args:
        sensitivity: Sobol indices per time step.
        path: Where the PNG goes.
        footnote: Small print.

    Returns:
        The path.
    """
    n_outputs, p = len(sensitivity.output_names), len(sensitivity.names)
    height = 0.7 + n_outputs * max(3.4, 0.24 * p + 0.6)
    with drawing(path, title=_title(sensitivity), height_in=height, footnote=footnote) as figure:
        panels = figure.subplots(n_outputs, 2, width_ratios=[1.75, 1.0], squeeze=False)
        for output in range(n_outputs):
            order = ranking(sensitivity, output)
            suffix = f" ({shortened(sensitivity.output_names[output])})" if n_outputs > 1 else ""
            _draw_stack(panels[output, 0], sensitivity, output, order)
            panels[output, 0].set_title(f"First order, each parameter alone{suffix}")
            _draw_bars(panels[output, 1], sensitivity, output, order)
            panels[output, 1].set_title("Total order, mean over time")
    return path


def _title(sensitivity: SensitivityRecord) -> str:
    order, mean = ranking(sensitivity, 0), mean_over_time(sensitivity.first_order[:, 0])
    top = [i for i in order[:3] if np.isfinite(mean[i]) and mean[i] > 0]
    # An estimate of nothing scatters around zero.
    top = [i for i in top if i == top[0] or mean[i] >= LEAST_NAMED]
    if not top:
        return "No parameter moves the output: its Sobol indices are undefined"
    of_output = f" of {sensitivity.output_names[0]}" if len(sensitivity.output_names) > 1 else ""
    verb = "explain" if len(top) > 1 else "explains"
    names = listed(sensitivity.names[i] for i in top)
    return f"{names} {verb} {percent(float(mean[top].sum()))} of the variance{of_output}, averaged over time"


def _color(rank: int) -> str:
    return SERIES[rank] if rank < N_LABELED else FAINT


def _draw_stack(axes: Axes, sensitivity: SensitivityRecord, output: int, order: Integers) -> None:
    time = time_axis(axes, sensitivity.time).of_seconds(sensitivity.time)
    indices = sensitivity.first_order[:, output][:, order]
    defined = np.asarray(np.isfinite(indices).all(axis=1), dtype=np.bool_)
    # An estimate may lie a little below zero; a share of the variance does not.
    upper = np.cumsum(np.clip(indices, 0.0, None), axis=1)
    lower = np.concatenate([np.zeros((len(time), 1)), upper[:, :-1]], axis=1)
    last = int(np.flatnonzero(defined)[-1]) if defined.any() else 0
    labels = []
    for rank in range(len(order)):
        axes.fill_between(
            time,
            lower[:, rank],
            upper[:, rank],
            where=defined.tolist(),
            color=_color(rank),
            linewidth=0.3,
            edgecolor="white",
            alpha=0.9,
        )
        if rank < N_LABELED and defined.any():
            middle = float(lower[last, rank] + upper[last, rank]) / 2
            labels.append(EndLabel(middle, sensitivity.names[order[rank]], _color(rank)))
    n_others = len(order) - N_LABELED
    if n_others > 0 and defined.any():
        middle = float(lower[last, N_LABELED] + upper[last, -1]) / 2
        labels.append(EndLabel(middle, f"{n_others} others" if n_others > 1 else "1 other", MUTED))
    axes.set_ylim(0.0, max(1.0, float(np.nanmax(upper)) * 1.02) if defined.any() else 1.0)
    axes.set_ylabel("share of the variance [1]")
    if not defined.all():
        text = f"undefined at {count((~defined).sum(), 'time step')}"
        axes.annotate(text, (0.01, 0.97), xycoords="axes fraction", va="top", fontsize=8, color=MUTED)
    end_labels(axes, labels)


def _draw_bars(axes: Axes, sensitivity: SensitivityRecord, output: int, order: Integers) -> None:
    total = mean_over_time(sensitivity.total_order[:, output])[order]
    half_width = mean_over_time(sensitivity.total_order_ci[:, output])[order]
    first = mean_over_time(sensitivity.first_order[:, output])[order]
    rows = np.arange(len(order), dtype=np.float64)
    shown = np.isfinite(total)
    colors = [_color(rank) for rank in range(len(order))]
    axes.barh(rows, np.where(shown, total, 0.0), height=0.68, color=colors, alpha=0.9, linewidth=0)
    axes.errorbar(
        total[shown],
        rows[shown],
        xerr=np.nan_to_num(half_width[shown]),
        fmt="none",
        ecolor=INK,
        elinewidth=1.0,
        capsize=2.0,
    )
    axes.plot(first, rows, linestyle="none", marker="|", markersize=8, markeredgewidth=1.6, color="white")
    axes.set_yticks(rows, [shortened(sensitivity.names[i]) for i in order], fontsize=8.5)
    axes.set_ylim(len(order) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.set_xlim(left=0.0)
    axes.set_xlabel("index [1]; white tick: first order")
