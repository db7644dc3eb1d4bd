"""The picture of optimizers on the physical model: error over calls, ours beside the paper's (Table 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from simulation.case import KnownError
from studies.report.drawing import (
    FAINT,
    SERIES,
    decimal_log,
    drawing,
    legend,
    mse_lines,
)
from studies.report.wording import axis_label


@dataclass(frozen=True)
class DirectPoint:
    """One row: ours, and the paper's where it has one.

    Attributes:
        method: Name of the optimizer.
        n_starts: Number of starts.
        n_calls: Model calls.
        mse: Final MSE. [unit squared]
        paper_calls: The paper's calls.
        paper_mse: The paper's MSE. [unit squared]
    """

    method: str
    n_starts: int
    n_calls: int
    mse: float
    paper_calls: int | None
    paper_mse: float | None


def direct_figure(
    points: Sequence[DirectPoint],
    references: Sequence[KnownError],
    path: Path,
    *,
    title: str,
    mse_unit: str,
    footnote: str = "",
) -> Path:
    """Draw error over model calls, the paper's rows hollow.

    Args:
        points: The rows, at least one.
        references: Known MSEs, drawn as lines.
        path: Where the PNG goes.
        title: What it shows.
        mse_unit: Unit of the MSE.
        footnote: Small print.

    Returns:
        The path.
    """
    colors = {
        method: SERIES[i % len(SERIES)] for i, method in enumerate(dict.fromkeys(p.method for p in points))
    }
    with drawing(path, title=title, height_in=4.4, footnote=footnote) as figure:
        axes = figure.subplots()
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(base=10.0))
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
        decimal_log(axes)
        mse_lines(axes, references)
        for point in points:
            _draw(axes, point, colors[point.method])
        axes.set_xlabel("model calls")
        axes.set_ylabel(axis_label("MSE", mse_unit))
        for method, color in colors.items():
            axes.plot([], linestyle="none", marker="o", color=color, label=method)
        legend(axes)
    return path


def _draw(axes: Axes, point: DirectPoint, color: str) -> None:
    if point.paper_calls is not None and point.paper_mse is not None:
        axes.plot(
            [point.n_calls, point.paper_calls],
            [point.mse, point.paper_mse],
            color=FAINT,
            linewidth=1.2,
            zorder=2,
        )
        axes.plot(
            point.paper_calls, point.paper_mse, marker="D", markersize=6, color="white",
            markeredgecolor=color, zorder=3,
        )  # fmt: skip
    axes.plot(point.n_calls, point.mse, marker="o", markersize=7.5, color=color, zorder=4)
    axes.annotate(
        str(point.n_starts), (point.n_calls, point.mse), (0, 7), textcoords="offset points", ha="center",
        fontsize=8, color=color,
    )  # fmt: skip
