"""Pictures of many calibrations: gap and polish of every size (Fig. 9), and how seeds spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from simulation.case import KnownError
from studies.report.drawing import (
    FAINT,
    INK,
    MUTED,
    POLISHED,
    SCREENED,
    decimal_log,
    drawing,
    legend,
    mse_lines,
)
from studies.report.figures_by_size import size_colors
from studies.report.findings import quartiles
from studies.report.records import Floats, Integers
from studies.report.wording import axis_label, count


@dataclass(frozen=True)
class PolishPath:
    """One calibration as Fig. 9 draws it.

    Attributes:
        n_train: Training-set size.
        mse_surrogate: By the surrogate at the screened point. [unit squared]
        mse_screened: By the model there; inf if it failed. [unit squared]
        calls: Calls of the polish so far, rising. Shape (h,).
        mse: Best MSE after them. Shape (h,). [unit squared]
    """

    n_train: int
    mse_surrogate: float
    mse_screened: float
    calls: Integers
    mse: Floats


def polish_paths_figure(
    paths: Sequence[PolishPath],
    references: Sequence[KnownError],
    path: Path,
    *,
    title: str,
    mse_unit: str,
    footnote: str = "",
) -> Path:
    """Draw the prediction gap of every size beside the MSE over the calls of its polish (Fig. 9).

    Args:
        paths: One per size.
        references: Known MSEs, drawn as lines.
        path: Where the PNG goes.
        title: What it shows.
        mse_unit: Unit of the MSE.
        footnote: Small print.

    Returns:
        The path.
    """
    colors = size_colors([one.n_train for one in paths])
    with drawing(path, title=title, height_in=4.4, footnote=footnote) as figure:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=[1.0, 1.5])
        for axes in (left, right):
            decimal_log(axes)
            mse_lines(axes, references)
        _draw_gaps(left, paths, colors)
        for one in paths:
            right.step(
                one.calls, one.mse, where="post", color=colors[one.n_train], linewidth=1.4, zorder=3,
                label=f"n = {count(one.n_train)}",
            )  # fmt: skip
        right.set_xlim(0.0, max(float(one.calls.max(initial=1)) for one in paths) * 1.02)
        right.set_title("MSE during the polish")
        right.set_xlabel("model calls of the polish")
        legend(right)
        left.set_ylabel(axis_label("MSE", mse_unit))
    return path


def _draw_gaps(axes: Axes, paths: Sequence[PolishPath], colors: Mapping[int, str]) -> None:
    axes.set_xticks(range(len(paths)), [str(one.n_train) for one in paths], rotation=45, ha="right")
    axes.set_xlim(-0.6, len(paths) - 0.4)
    axes.grid(visible=False, axis="x")
    for place, one in enumerate(paths):
        color = colors[one.n_train]
        if np.isfinite(one.mse_screened):
            axes.plot([place] * 2, [one.mse_surrogate, one.mse_screened], color=FAINT, linewidth=4, zorder=1)
            axes.plot(place, one.mse_screened, marker="D", markersize=6.5, color=color, zorder=4)
        axes.plot(
            place, one.mse_surrogate, marker="o", markersize=7, color="white", markeredgecolor=color, zorder=3
        )
    axes.set_title("○ surrogate   ◆ model")
    axes.set_xlabel("training simulations")


@dataclass(frozen=True)
class SeedPanel:
    """One quantity over seeds.

    Attributes:
        heading: What it is.
        label: Of the vertical axis.
        values: By training-set size, one value per seed; inf where it was never reached.
        paper: The paper's one value by size, where it has one.
        is_log: Whether the axis is logarithmic.
    """

    heading: str
    label: str
    values: Mapping[int, Floats]
    paper: Mapping[int, float]
    is_log: bool


def seeds_figure(panels: Sequence[SeedPanel], path: Path, *, title: str, footnote: str = "") -> Path:
    """Draw every seed as a dot, median and quartiles beside, and the paper's one value.

    Args:
        panels: One quantity each.
        path: Where the PNG goes.
        title: What it shows.
        footnote: Small print.

    Returns:
        The path.
    """
    with drawing(path, title=title, height_in=3.9, footnote=footnote) as figure:
        for axes, panel in zip(figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True):
            _draw_seeds(axes, panel)
    return path


def _draw_seeds(axes: Axes, panel: SeedPanel) -> None:
    if panel.is_log:
        decimal_log(axes)
    for place, (size, values) in enumerate(panel.values.items()):
        good = values[np.isfinite(values)]
        sideways = place + 0.16 * np.linspace(-1.0, 1.0, len(good)) if len(good) > 1 else np.full(1, place)
        axes.plot(sideways[: len(good)], good, linestyle="none", marker="o", markersize=4, color=POLISHED,
                  alpha=0.55, markeredgewidth=0)  # fmt: skip
        low, middle, high = quartiles(values)
        if np.isfinite(middle):
            top = high if np.isfinite(high) else good.max()
            axes.plot([place + 0.3] * 2, [low, top], color=INK, linewidth=1.2)
            axes.plot(place + 0.3, middle, marker="_", markersize=9, markeredgewidth=2.0, color=INK)
        if size in panel.paper:
            axes.plot(place - 0.3, panel.paper[size], marker="D", markersize=6, color=SCREENED)
        missing = len(values) - len(good)
        if missing:
            axes.annotate(f"{missing} never", (place, 0.99), xycoords=("data", "axes fraction"), ha="center",
                          va="top", fontsize=8, color=MUTED)  # fmt: skip
    if not panel.is_log:
        axes.set_ylim(bottom=0.0)
    axes.set_xticks(range(len(panel.values)), [str(size) for size in panel.values])
    axes.set_xlim(-0.6, len(panel.values) - 0.4)
    axes.grid(visible=False, axis="x")
    axes.set_title(panel.heading)
    axes.set_xlabel("training simulations")
    axes.set_ylabel(panel.label)
