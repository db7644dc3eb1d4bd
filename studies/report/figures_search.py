"""Pictures of one search: learning curves, importances, slices and parallel coordinates of its trials."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from studies.report.drawing import (
    BEST_SURROGATE,
    FAINT,
    INK,
    MUTED,
    POLISHED,
    SURROGATE,
    decimal_log,
    drawing,
    log_limits,
)
from studies.report.records import Floats
from studies.report.records_search import SearchRecord
from studies.report.wording import axis_label, count, percent, quantity, setting

N_CURVES = 200  # more lines would be one dark area, and take seconds to draw
_RANKS = LinearSegmentedColormap.from_list("ranks", ["#e3e0ea", SURROGATE, BEST_SURROGATE])


def search_figures(search: SearchRecord, folder: Path, *, unit: str, footnote: str = "") -> list[Path]:
    """Draw every picture that the trials are enough for.

    Args:
        search: The trials.
        folder: Where the PNG files go.
        unit: Unit of the errors, e.g. "K".
        footnote: Small print.

    Returns:
        The files.
    """
    made = []
    if search.curves:
        made.append(curves_figure(search, folder / "learning_curves.png", unit=unit, footnote=footnote))
    if len(search.judged) >= 2 and search.names:
        made.append(slices_figure(search, folder / "slices.png", unit=unit, footnote=footnote))
    if len(search.judged) >= 3 and len(search.names) >= 2:
        made.append(
            parallel_figure(search, folder / "parallel_coordinates.png", unit=unit, footnote=footnote)
        )
    if np.isfinite(search.importance).any():
        made.append(importances_figure(search, folder / "importances.png", footnote=footnote))
    return made


def curves_figure(search: SearchRecord, path: Path, *, unit: str, footnote: str = "") -> Path:
    """Draw the validation error over epochs of all trials, the best one on top."""
    with drawing(path, title=_best_title(search, unit), height_in=3.6, footnote=footnote) as figure:
        axes = figure.subplots()
        early, late = search.curves[:-N_CURVES], search.curves[-N_CURVES:]
        kept = [*(curve for curve in early if curve.is_best), *late]
        shown = sorted(kept, key=lambda curve: curve.is_best)
        decimal_log(axes, *log_limits(np.concatenate([curve.validation_mae for curve in shown])))
        for curve in shown:
            color = MUTED if curve.state == "pruned" else SURROGATE
            axes.plot(
                curve.epoch,
                curve.validation_mae,
                color=BEST_SURROGATE if curve.is_best else color,
                linewidth=2.2 if curve.is_best else 0.9,
                alpha=1.0 if curve.is_best else 0.55,
                zorder=4 if curve.is_best else 2,
            )
            if curve.state == "pruned":
                axes.plot(curve.epoch[-1:], curve.validation_mae[-1:], "o", markersize=3.5, color=MUTED)
        axes.set(xlabel="epoch", ylabel=axis_label("validation MAE", unit))
        pruned = sum(curve.state == "pruned" for curve in shown)
        lines = [("best trial", BEST_SURROGATE), (count(len(shown) - pruned, "complete trial"), SURROGATE)]
        _legend(axes, [*lines, (f"{count(pruned)} pruned", MUTED)] if pruned else lines)
    return path


def slices_figure(search: SearchRecord, path: Path, *, unit: str, footnote: str = "") -> Path:
    """Draw the error over each hyperparameter, one point per trial."""
    n_columns = min(len(search.names), 4)
    n_rows = -(-len(search.names) // n_columns)
    with drawing(
        path, title=_best_title(search, unit), height_in=0.7 + 2.6 * n_rows, footnote=footnote
    ) as figure:
        panels = figure.subplots(n_rows, n_columns, sharey=True, squeeze=False).ravel()
        limits = log_limits(search.error)
        for number, name in enumerate(search.names):
            axes = panels[number]
            decimal_log(axes, *limits)
            _points(axes, search, search.values[:, number])
            _hyperparameter_axis(axes, search, number)
            axes.set_xlabel(name)
        for axes in panels[len(search.names) :]:
            axes.set_visible(False)
        for row in range(n_rows):
            panels[row * n_columns].set_ylabel(axis_label("validation MAE", unit))
    return path


def parallel_figure(search: SearchRecord, path: Path, *, unit: str, footnote: str = "") -> Path:
    """Draw a line per trial through its hyperparameters and its error, dark where the error is small."""
    with drawing(path, title=_best_title(search, unit), height_in=4.0, footnote=footnote) as figure:
        axes = figure.subplots()
        _parallel_lines(figure, axes, search, unit)
    return path


def importances_figure(search: SearchRecord, path: Path, *, footnote: str = "") -> Path:
    """Draw how much of the error's variation each hyperparameter explains."""
    order = np.argsort(np.nan_to_num(search.importance))
    first = int(order[-1])
    n_judged = len(search.judged)
    title = (
        f"{search.names[first]} explains {percent(float(search.importance[first]))} of what separates good "
        f"trials from the others (PED-ANOVA, {count(n_judged, 'trial')})"
    )
    with drawing(path, title=title, height_in=1.2 + 0.36 * len(order), footnote=footnote) as figure:
        axes = figure.subplots()
        values = np.nan_to_num(search.importance[order])
        axes.barh(np.arange(len(order)), values, color=POLISHED, height=0.62)
        axes.set_yticks(np.arange(len(order)), [search.names[i] for i in order])
        for place, value in enumerate(values):
            axes.annotate(
                percent(float(value)), (float(value), place), (4, 0), textcoords="offset points", va="center"
            )
        axes.set_xlim(0.0, max(1.15 * float(values.max()), 0.1))
        axes.set_xlabel("importance [1]")
        axes.grid(visible=False, axis="y")
    return path


def _best_title(search: SearchRecord, unit: str) -> str:
    best = np.flatnonzero(search.is_best)
    if not best.size:
        return f"n = {search.n_train}: none of {count(len(search.state), 'trial')} has an error yet"
    settings = ", ".join(
        f"{name} {setting(float(search.values[best[0], i]), 2)}" for i, name in enumerate(search.names)
    )
    error = quantity(float(search.error[best[0]]), unit)
    return (
        f"n = {search.n_train}: the best of {count(len(search.state), 'trial')} errs by {error} ({settings})"
    )


def _points(axes: Axes, search: SearchRecord, x: Floats) -> None:
    states = np.array(search.state, dtype=object)
    for state, fill, edge in (("pruned", "none", MUTED), ("complete", SURROGATE, SURROGATE)):
        rows = (states == state) & np.isfinite(search.error)
        axes.plot(
            x[rows], search.error[rows], linestyle="none", marker="o", markersize=4.5, alpha=0.75,
            color=fill, markeredgecolor=edge, markeredgewidth=0.9,
        )  # fmt: skip
    best = search.is_best
    axes.plot(
        x[best], search.error[best], linestyle="none", marker="*", markersize=13,
        color=BEST_SURROGATE, markeredgecolor="white", zorder=5,
    )  # fmt: skip


def _hyperparameter_axis(axes: Axes, search: SearchRecord, number: int) -> None:
    values = search.values[np.isfinite(search.values[:, number]), number]
    if search.is_log[number] and values.size and values.min() > 0:
        axes.set_xscale("log")
        axes.minorticks_off()
        ticks = _log_ticks(values)
        axes.set_xticks(ticks, [setting(tick, 2) for tick in ticks])
        axes.set_xlim(*log_limits(values))
    elif values.size and (values == np.round(values)).all() and len(np.unique(values)) <= 6:
        axes.set_xticks(np.unique(values))


def _log_ticks(values: Floats) -> list[float]:
    """Return values to write below a logarithmic axis: those there are, where they are few, else three."""
    present = np.unique(values)
    if len(present) <= 4:
        return [float(value) for value in present]
    low, high = float(present[0]), float(present[-1])
    return [low, float(np.sqrt(low * high)), high]


def _parallel_lines(figure: Figure, axes: Axes, search: SearchRecord, unit: str) -> None:
    rows = search.judged
    columns = [*search.values.T, search.error]
    logarithmic = [*search.is_log.tolist(), True]
    heights = [_heights(column, is_log) for column, is_log in zip(columns, logarithmic, strict=True)]
    for rank, row in enumerate(rows):
        line = [column[row] for column in heights]
        is_best = bool(search.is_best[row])
        color = BEST_SURROGATE if is_best else _RANKS(rank / max(len(rows) - 1, 1))
        axes.plot(
            line,
            color=color,
            linewidth=2.4 if is_best else 1.0,
            alpha=1.0 if is_best else 0.8,
            zorder=2 + rank,
        )
    for place, (column, is_log) in enumerate(zip(columns, logarithmic, strict=True)):
        axes.axvline(place, color=FAINT, linewidth=1.0, zorder=1)
        usable = column[np.isfinite(column)]
        if not usable.size:
            continue
        low, high = float(usable.min()), float(usable.max())
        middle = float(np.sqrt(low * high)) if is_log and low > 0 else 0.5 * (low + high)
        for height, value in ((0.0, low), (0.5, middle), (1.0, high)) if high > low else ((0.5, low),):
            axes.annotate(
                setting(value, 2), (place, height), (4, 0),
                textcoords="offset points", va="center", fontsize=8, color=INK, zorder=1000,
                bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.75},
            ).set_in_layout(False)  # fmt: skip
    axes.set_xticks(range(len(columns)), [*search.names, axis_label("val MAE", unit)])
    axes.set_xlim(-0.15, len(columns) - 0.6)
    axes.set_ylim(-0.07, 1.07)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.spines["left"].set_visible(False)
    axes.spines["bottom"].set_visible(False)


def _heights(column: Floats, is_log: bool) -> Floats:
    values = np.log(column) if is_log and np.nanmin(column) > 0 else column
    low, high = np.nanmin(values), np.nanmax(values)
    return np.full(len(values), 0.5) if high <= low else np.asarray((values - low) / (high - low))


def _legend(axes: Axes, lines: list[tuple[str, str]]) -> None:
    for number, (line, color) in enumerate(lines):
        axes.annotate(
            line, (0.985, 0.97), (0, -13 * number), xycoords="axes fraction", textcoords="offset points",
            ha="right", va="top", fontsize=8.5, color=color, zorder=7,
        ).set_in_layout(False)  # fmt: skip
