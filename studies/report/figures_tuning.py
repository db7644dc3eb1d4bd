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
    EndLabel,
    category_log,
    decimal_log,
    drawing,
    end_labels,
    log_limits,
)
from studies.report.findings import best_trials
from studies.report.records import Floats
from studies.report.records_tuning import ErrorLine, LearningCurves, TrialsRecord
from studies.report.wording import axis_label, count, quantity, significant

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
        trials: All trials; pruned ones are drawn at their last validation error, failed ones at the edge.
        path: Where the PNG goes.
        unit: Unit of the errors, e.g. "K".
        footnote: Small print.
        beside: At most two other surrogates, drawn as lines.
        published: MAE that the paper names, by training-set size: one value, or least and largest. [unit]

    Returns:
        The path.
    """
    best = best_trials(trials)
    with drawing(path, title=_mae_title(trials, unit), height_in=3.9, footnote=footnote) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        pruned = np.array([state == "pruned" for state in trials.state], dtype=bool)
        others = [values for line in beside for values in (line.mae, line.p90)]
        theirs = np.array([value for values in published.values() for value in values], dtype=np.float64)
        everything = np.concatenate(
            [trials.test_mae, trials.test_p90, trials.validation_mae[pruned], *others, theirs]
        )
        low, high = log_limits(everything)
        # Room for the numbers below the stars and for the explanation above the points.
        limits = (low / (high / low) ** 0.14, high * (high / low) ** 0.2)
        for axes, values, what in zip(
            panels, (trials.test_mae, trials.test_p90), ("MAE", "90th percentile"), strict=True
        ):
            sizes = sorted({int(n) for n in trials.n_train})
            labeled = category_log(axes, sizes)
            if sizes:
                axes.set_xlim(sizes[0] / 1.4, sizes[-1] * 1.4)
            decimal_log(axes, *limits)
            axes.grid(visible=False, axis="x")
            _draw_trials(axes, trials, values, is_mae=what == "MAE")
            for line, (color, dashes) in zip(beside, LINES, strict=False):
                errors = line.mae if what == "MAE" else line.p90
                axes.plot(line.n_train, errors, color=color, linestyle=dashes, linewidth=1.4, zorder=3.5)
            if what == "MAE":
                _draw_published(axes, published)
            axes.plot(trials.n_train[best], values[best], color=BEST_SURROGATE, linewidth=1.1, zorder=4)
            axes.plot(
                trials.n_train[best], values[best], linestyle="none", marker="*", markersize=13,
                color=BEST_SURROGATE, markeredgecolor="white", markeredgewidth=0.8, zorder=5,
            )  # fmt: skip
            for i in (i for i in best if trials.n_train[i] in labeled):
                axes.annotate(
                    significant(float(values[i]), 2), (float(trials.n_train[i]), float(values[i])), (0, -9),
                    textcoords="offset points", ha="center", va="top", fontsize=8.5,
                    color=BEST_SURROGATE, zorder=6,
                ).set_in_layout(False)  # fmt: skip
            axes.set_title("Mean absolute error" if what == "MAE" else "90th percentile over parameter sets")
            axes.set_xlabel("training simulations")
        panels[0].set_ylabel(axis_label("error on the test set", unit))
        _explain_marks(panels[1], trials, beside, is_published=bool(published))
    return path


def _draw_published(axes: Axes, published: Mapping[int, tuple[float, ...]]) -> None:
    for n, values in published.items():
        axes.plot(
            [n] * len(values), values, color=INK, linewidth=1.2, marker="D", markersize=5,
            markerfacecolor="white", zorder=4.5,
        )  # fmt: skip


def _mae_title(trials: TrialsRecord, unit: str) -> str:
    best = best_trials(trials)
    if not best.size:
        return f"None of {count(len(trials.state), 'trial')} has a test error yet"
    smallest, largest = best[0], best[-1]
    if smallest == largest:
        error = quantity(float(trials.test_mae[smallest]), unit, 2)
        simulations = count(trials.n_train[smallest], "training simulation")
        return f"With {simulations} the best surrogate errs by {error} on average"
    first, last = float(trials.test_mae[smallest]), float(trials.test_mae[largest])
    verb = "falls" if last < first else "goes"
    return (
        f"The best surrogate's error {verb} from {quantity(first, unit, 2)} with "
        f"{count(trials.n_train[smallest])} training simulations to {quantity(last, unit, 2)} "
        f"with {count(trials.n_train[largest])}"
    )


def _draw_trials(axes: Axes, trials: TrialsRecord, values: Floats, *, is_mae: bool) -> None:
    x = _beside_each_other(trials.n_train)
    state = np.array(trials.state, dtype=object)
    complete = (state == "complete") & np.isfinite(values)
    axes.plot(
        x[complete], values[complete], linestyle="none", marker="o", markersize=4.5,
        color=SURROGATE, alpha=0.6, markeredgewidth=0, zorder=3,
    )  # fmt: skip
    pruned = (state == "pruned") & np.isfinite(trials.validation_mae)
    if is_mae and pruned.any():
        axes.plot(
            x[pruned], trials.validation_mae[pruned], linestyle="none", marker="o", markersize=4,
            color="none", markeredgecolor=MUTED, alpha=0.7, zorder=2,
        )  # fmt: skip
    failed = x[state == "failed"]
    # The layout would keep room for a line without points at the picture's corner.
    if is_mae and failed.size:
        axes.plot(
            failed, np.full(len(failed), axes.get_ylim()[1]), linestyle="none", marker="x", markersize=5,
            color=MUTED, alpha=0.6, clip_on=False, zorder=2,
        )  # fmt: skip


def _beside_each_other(n_train: Floats | np.ndarray[tuple[int], np.dtype[np.int64]]) -> Floats:
    """Spread trials of one size over a tenth of an octave each way, in their order. Shape (m,)."""
    x = np.asarray(n_train, dtype=np.float64).copy()
    for size in np.unique(n_train):
        rows = np.flatnonzero(n_train == size)
        if len(rows) > 1:
            x[rows] *= 2.0 ** np.linspace(-0.22, 0.22, len(rows))
    return x


def _explain_marks(
    axes: Axes, trials: TrialsRecord, beside: Sequence[ErrorLine], *, is_published: bool
) -> None:
    n = {state: trials.state.count(state) for state in ("complete", "pruned", "failed")}
    lines = [
        ("★ best by validation", BEST_SURROGATE),
        (f"● {count(n['complete'], 'complete trial')}", SURROGATE),
    ]
    if n["pruned"]:
        lines.append((f"○ {count(n['pruned'])} pruned (left, at the last validation)", MUTED))
    if n["failed"]:
        lines.append((f"× {count(n['failed'])} failed (left, upper edge)", MUTED))
    lines += [(f"— {line.name}", color) for line, (color, _) in zip(beside, LINES, strict=False)]
    if is_published:
        lines.append(("◇ the paper (left)", INK))
    for number, (line, color) in enumerate(lines):
        axes.annotate(
            line, (0.985, 0.985), (0, -12.5 * number), xycoords="axes fraction", textcoords="offset points",
            ha="right", va="top", fontsize=8.5, color=color, zorder=7,
        ).set_in_layout(False)  # fmt: skip


def learning_curves_figure(curves: LearningCurves, path: Path, *, unit: str, footnote: str = "") -> Path:
    """Draw one training: validation error over epochs, and the terms of the training loss beside.

    Args:
        curves: History of the training.
        path: Where the PNG goes.
        unit: Unit of the validation error, e.g. "K".
        footnote: Small print.

    Returns:
        The path.
    """
    finite = np.isfinite(curves.validation_mae)
    best = float(np.min(curves.validation_mae[finite])) if finite.any() else float("nan")
    title = (
        f"Trained on {count(curves.n_train, 'simulation')}, the validation error is lowest at epoch "
        f"{count(curves.best_epoch)}: {quantity(best, unit)}"
        if finite.any()
        else f"Training on {count(curves.n_train, 'simulation')} was never validated"
    )
    with drawing(path, title=title, height_in=3.4, footnote=footnote) as figure:
        left, right = figure.subplots(1, 2)
        decimal_log(left, *log_limits(curves.validation_mae))
        left.plot(curves.epoch[finite], curves.validation_mae[finite], color=SURROGATE)
        if finite.any():
            left.axvline(curves.best_epoch, color=MUTED, linewidth=0.9, linestyle=(0, (5, 3)))
            left.plot(
                [curves.best_epoch],
                [best],
                marker="*",
                markersize=12,
                color=BEST_SURROGATE,
                markeredgecolor="white",
            )
        left.set(title="Error on the validation set", xlabel="epoch", ylabel=axis_label("MAE", unit))
        _draw_terms(right, curves)
        right.set(title="Training loss and its terms", xlabel="epoch", ylabel="loss [1]")
    return path


def _draw_terms(axes: Axes, curves: LearningCurves) -> None:
    values = np.concatenate([v for _, v in curves.terms]) if curves.terms else np.empty(0)
    decimal_log(axes, *log_limits(values))
    labels = []
    colors = (INK, *SERIES)
    for number, (name, term) in enumerate(curves.terms):
        color = colors[number % len(colors)]
        usable = np.isfinite(term) & (term > 0)
        if not usable.any():
            continue
        axes.plot(curves.epoch[usable], term[usable], color=color, linewidth=1.2)
        labels.append(EndLabel(float(term[usable][-1]), name.replace("_", " "), color))
    end_labels(axes, labels)
