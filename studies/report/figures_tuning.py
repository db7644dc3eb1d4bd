"""Pictures of learning: every trial's error over the training-set size (Fig. 6), one training's curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes

from studies.report.drawing import (
    BEST_SURROGATE,
    INK,
    MUTED,
    SERIES,
    SURROGATE,
    decimal_log,
    drawing,
    sizes_axis,
)
from studies.report.findings import best_trials
from studies.report.records import Floats
from studies.report.records_tuning import ErrorLine, TrialsRecord
from studies.report.wording import axis_label, count, significant

LINES = ((SERIES[2], "-"), (SERIES[4], (0, (4, 2))))
"""Color and dashes of the surrogates that are drawn as lines beside the trials."""


def mae_over_n_figure(
    trials: TrialsRecord,
    path: Path,
    *,
    unit: str,
    footnote: str = "",
    beside: Sequence[ErrorLine] = (),
    published: Mapping[int, tuple[float, ...]] = MappingProxyType({}),
) -> Path:
    """Draw every trial's test error over the training-set size, mean beside 90th percentile (Fig. 6).

    Args:
        trials: All trials; pruned ones are drawn at their last validation error, failed ones counted.
        path: Where the PNG goes.
        unit: Unit of the errors, e.g. "K".
        footnote: Small print.
        beside: At most two other surrogates, drawn as lines.
        published: MAE that the paper names, by training-set size: one value, or least and largest. [unit]

    Returns:
        The path.
    """
    title = "Error of every trial over the number of training simulations"
    with drawing(path, title=title, height_in=4.3, footnote=footnote) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, values in zip(panels, (trials.test_mae, trials.test_p90), strict=True):
            decimal_log(axes)
            sizes_axis(axes)
            axes.grid(visible=False, axis="x")
            axes.set_xlabel("training simulations")
            is_mae = values is trials.test_mae
            _draw_trials(axes, trials, values, is_mae=is_mae)
            for line, (color, dashes) in zip(beside, LINES, strict=False):
                errors = line.mae if is_mae else line.p90
                axes.plot(
                    line.n_train, errors, color=color, linestyle=dashes, linewidth=1.4, zorder=3.5,
                    label=line.name,
                )  # fmt: skip
        for n, errors_there in published.items():
            panels[0].plot(
                [n] * len(errors_there), errors_there, color=INK, linewidth=1.2, marker="D", markersize=5,
                markerfacecolor="white", zorder=4.5, label="the paper",
            )  # fmt: skip
        panels[0].set_title("Mean absolute error")
        panels[1].set_title("90th percentile over parameter sets")
        panels[0].set_ylabel(axis_label("error on the test set", unit))
        named = dict(zip(*reversed(panels[0].get_legend_handles_labels()), strict=True))
        panels[1].legend(named.values(), named, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return path


def _draw_trials(axes: Axes, trials: TrialsRecord, values: Floats, *, is_mae: bool) -> None:
    x, state = _beside_each_other(trials), np.array(trials.state, dtype=object)
    complete = (state == "complete") & np.isfinite(values)
    failed = f"\n({count(n)} failed)" if (n := trials.state.count("failed")) else ""
    axes.plot(
        x[complete], values[complete], linestyle="none", marker="o", markersize=4.5,
        color=SURROGATE, alpha=0.6, markeredgewidth=0, zorder=3,
        label=f"{count(complete.sum(), 'complete trial')}{failed}",
    )  # fmt: skip
    pruned = (state == "pruned") & np.isfinite(trials.validation_mae)
    if is_mae and pruned.any():
        axes.plot(
            x[pruned], trials.validation_mae[pruned], linestyle="none", marker="o", markersize=4,
            color="none", markeredgecolor=MUTED, alpha=0.7, zorder=2,
            label=f"{count(pruned.sum())} pruned, at\nthe last validation",
        )  # fmt: skip
    best = best_trials(trials)
    axes.plot(
        trials.n_train[best], values[best], linewidth=1.1, marker="*", markersize=13,
        color=BEST_SURROGATE, markeredgecolor="white", markeredgewidth=0.8, zorder=5,
        label="best by validation",
    )  # fmt: skip
    for i in best:
        axes.annotate(
            significant(float(values[i]), 2), (float(trials.n_train[i]), float(values[i])), (0, -9),
            textcoords="offset points", ha="center", va="top", fontsize=8.5, color=BEST_SURROGATE, zorder=6,
        )  # fmt: skip


def _beside_each_other(trials: TrialsRecord) -> Floats:
    """Spread trials of one size over a tenth of an octave each way, in their order. Shape (m,)."""
    x = trials.n_train.astype(np.float64)
    for size in np.unique(trials.n_train):
        rows = np.flatnonzero(trials.n_train == size)
        if len(rows) > 1:
            x[rows] *= 2.0 ** np.linspace(-0.22, 0.22, len(rows))
    return x
