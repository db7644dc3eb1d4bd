"""Pictures of surrogates by training-set size: error over a setting, and over a spread of tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, to_hex

from studies.report.drawing import (
    INK,
    decimal_log,
    drawing,
    legend,
    sizes_axis,
)
from studies.report.records import Floats
from studies.report.wording import axis_label, count

_FEW_TO_MANY = LinearSegmentedColormap.from_list("sizes", ["#e0a458", "#b5657a", "#5b4a8b", "#1d3557"])


def size_colors(sizes: Sequence[int]) -> dict[int, str]:
    """Return a color per training-set size, from light for few simulations to dark for many."""
    places = np.linspace(0.0, 1.0, max(len(sizes), 2))
    return {size: to_hex(_FEW_TO_MANY(place)) for size, place in zip(sorted(sizes), places, strict=False)}


@dataclass(frozen=True)
class SettingTrials:
    """The trials of one size.

    Attributes:
        values: Of the setting, complete trials. Shape (m,).
        test_mae: Test errors of complete trials. Shape (m,).
        best: Position of the trial chosen by validation error.
        pruned_values: Of the setting, pruned trials. Shape (q,).
        pruned_mae: Their last validation errors. Shape (q,).
    """

    values: Floats
    test_mae: Floats
    best: int
    pruned_values: Floats
    pruned_mae: Floats


def setting_figure(
    trials: Mapping[int, SettingTrials], path: Path, *, what: str, title: str, unit: str, footnote: str = ""
) -> Path:
    """Draw every trial's error over a setting, the best of each size as a star, pruned ones hollow.

    Args:
        trials: By training-set size.
        path: Where the PNG goes.
        what: Name of the setting.
        title: What it shows.
        unit: Unit of the errors.
        footnote: Small print.

    Returns:
        The path.
    """
    colors = size_colors(list(trials))
    with drawing(path, title=title, height_in=3.9, footnote=footnote) as figure:
        axes = figure.subplots()
        sizes_axis(axes)
        decimal_log(axes)
        for size, group in trials.items():
            best = group.best
            axes.plot(
                group.pruned_values, group.pruned_mae, linestyle="none", marker="o", markersize=3.5,
                color="none", markeredgecolor=colors[size], alpha=0.45,
            )  # fmt: skip
            axes.plot(
                group.values, group.test_mae, linestyle="none", marker="o", markersize=4.5,
                color=colors[size], alpha=0.7, markeredgewidth=0, label=f"n = {count(size)}",
            )  # fmt: skip
            axes.plot(
                group.values[best], group.test_mae[best], linestyle="none", marker="*", markersize=13,
                color=colors[size], markeredgecolor="white", markeredgewidth=0.8, zorder=4,
            )  # fmt: skip
        axes.set_xlabel(f"{what} (★ chosen by validation error, ○ pruned, at the last validation error)")
        axes.set_ylabel(axis_label("MAE", unit))
        legend(axes)
    return path


@dataclass(frozen=True)
class SpreadErrors:
    """Errors on test sets of rising spread.

    Attributes:
        heading: Which parameters are restricted.
        mae: Mean absolute error by size, each of shape (s,).
        p90: 90th percentile over the rows by size, each of shape (s,).
    """

    heading: str
    mae: Mapping[int, Floats]
    p90: Mapping[int, Floats]


def spread_figure(
    spreads: Floats,
    kinds: Sequence[SpreadErrors],
    path: Path,
    *,
    title: str,
    unit: str,
    footnote: str = "",
) -> Path:
    """Draw errors over the spread of the test set, a panel per kind of restriction (Fig. 7).

    Args:
        spreads: The spreads, rising. Shape (s,). [1]
        kinds: One panel each.
        path: Where the PNG goes.
        title: What it shows.
        unit: Unit of the errors.
        footnote: Small print.

    Returns:
        The path.
    """
    with drawing(path, title=title, height_in=4.3, footnote=footnote) as figure:
        panels = figure.subplots(1, len(kinds), sharey=True, squeeze=False)[0]
        for axes, kind in zip(panels, kinds, strict=True):
            _draw_spread(axes, spreads, kind)
        panels[0].set_ylabel(axis_label("error", unit))
        legend(panels[-1])
    return path


def _draw_spread(axes: Axes, spreads: Floats, kind: SpreadErrors) -> None:
    colors = size_colors(list(kind.mae))
    decimal_log(axes)
    axes.set_xlim(float(spreads[0]), float(spreads[-1]))
    for size, mae in kind.mae.items():
        axes.plot(spreads, mae, color=colors[size], zorder=3, label=f"n = {count(size)}")
        axes.plot(spreads, kind.p90[size], color=colors[size], linewidth=1.0, linestyle=(0, (2, 2)), zorder=2)
    axes.set_title(kind.heading)
    axes.set_xlabel("spread δ of the test set [1]")
    axes.annotate(
        "— MAE   ··· 90th percentile", (0.02, 0.02), xycoords="axes fraction", fontsize=8.5, color=INK
    )
