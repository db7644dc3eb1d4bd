"""Pictures of uniqueness: optima as parallel coordinates (Fig. 8), and what the data determine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from studies.report.drawing import (
    POLISHED,
    SCREENED,
    SERIES,
    decimal_log,
    drawing,
    legend,
    shortened,
)
from studies.report.records import Floats
from studies.report.wording import count


@dataclass(frozen=True)
class Bundle:
    """Optima drawn in one color.

    Attributes:
        name: What they have in common.
        u: Optima, from lower to upper bound. Shape (n, p). [1]
    """

    name: str
    u: Floats


@dataclass(frozen=True)
class BundlePanel:
    """A panel of parallel coordinates."""

    heading: str
    bundles: tuple[Bundle, ...]


def parallel_coordinates_figure(
    names: Sequence[str], panels: Sequence[BundlePanel], path: Path, *, title: str, footnote: str = ""
) -> Path:
    """Draw optima as lines over the parameters, each from its lower to its upper bound (Fig. 8).

    Args:
        names: One per parameter.
        panels: One below the other.
        path: Where the PNG goes.
        title: What it shows.
        footnote: Small print.

    Returns:
        The path.
    """
    with drawing(path, title=title, height_in=0.4 + 3.0 * len(panels), footnote=footnote) as figure:
        for axes, panel in zip(figure.subplots(len(panels), 1, squeeze=False)[:, 0], panels, strict=True):
            _draw_bundles(axes, panel)
            axes.set_xticks(
                range(len(names)), [shortened(name, 12) for name in names], rotation=30, ha="right"
            )
            axes.set_title(panel.heading)
    return path


def _draw_bundles(axes: Axes, panel: BundlePanel) -> None:
    for number, bundle in enumerate(panel.bundles):
        color = SERIES[number % len(SERIES)]
        places = np.broadcast_to(np.arange(bundle.u.shape[1], dtype=np.float64), bundle.u.shape)
        alpha = float(np.clip(12.0 / max(len(bundle.u), 1), 0.12, 0.9))
        lines = np.stack([places, bundle.u], axis=-1)
        label = f"{bundle.name} ({count(len(bundle.u))})"
        axes.add_collection(
            LineCollection(list(lines), colors=color, linewidths=1.0, alpha=alpha, zorder=3, label=label)
        )
    legend(axes)
    axes.set_xlim(0.0, (panel.bundles[0].u.shape[1] - 1) if panel.bundles else 1.0)
    axes.set_ylim(-0.02, 1.02)
    axes.set_yticks([0.0, 0.5, 1.0], ["lower bound", "", "upper bound"])


def identifiability_figure(
    names: Sequence[str],
    correlation: Floats,
    spread: Floats,
    singular_values: Floats,
    path: Path,
    *,
    title: str,
    footnote: str = "",
) -> Path:
    """Draw the correlation of the estimates, their spread, and the singular values of the Jacobian.

    Args:
        names: One per parameter.
        correlation: Shape (p, p). [1]
        spread: Standard deviation of each parameter as a share of its range. Shape (p,). [1]
        singular_values: Falling. Shape (p,). [first output's unit per range]
        path: Where the PNG goes.
        title: What it shows.
        footnote: Small print.

    Returns:
        The path.
    """
    p = len(names)
    labels = [shortened(name, 12) for name in names]
    with drawing(path, title=title, height_in=5.0, footnote=footnote) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=[1.35, 1.0])
        left = figure.add_subplot(grid[:, 0])
        image = left.imshow(correlation, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
        left.set_xticks(range(p), labels, rotation=90, fontsize=8)
        left.set_yticks(range(p), labels, fontsize=8)
        left.grid(visible=False)
        left.set_title("Correlation of the estimates")
        figure.colorbar(image, ax=left, shrink=0.6)
        order = np.argsort(spread)
        top = figure.add_subplot(grid[0, 1])
        top.barh(np.arange(p), spread[order], height=0.7, color=POLISHED, linewidth=0)
        top.set_yticks(range(p), [labels[i] for i in order], fontsize=7.5)
        top.set_ylim(p - 0.4, -0.6)
        top.tick_params(axis="y", length=0)
        top.grid(visible=False, axis="y")
        top.set_title("Standard deviation / range")
        bottom = figure.add_subplot(grid[1, 1])
        shares = singular_values / singular_values.max()
        decimal_log(bottom)
        bottom.plot(np.arange(1, p + 1), shares, linestyle="none", marker="s", color=SCREENED)
        bottom.set_title("Singular values / largest")
        bottom.set_xticks(range(1, p + 1, 3))
        bottom.set_xlabel("direction")
    return path
