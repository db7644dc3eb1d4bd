"""The picture of all calibrations side by side, by training-set size."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from studies.report.data import Reference
from studies.report.drawing import (
    FAINT,
    INK,
    MUTED,
    POLISHED,
    SCREENED,
    SURROGATE,
    EndLabel,
    decimal_log,
    drawing,
    end_labels,
    log_limits,
)
from studies.report.findings import last_finite
from studies.report.records import CalibrationRecord
from studies.report.wording import axis_label, count, quantity, significant


def overview_figure(
    calibrations: Sequence[CalibrationRecord],
    references: Sequence[Reference],
    path: Path,
    *,
    mse_unit: str,
    footnote: str = "",
) -> Path:
    """Draw, for every calibration, the MSE by the surrogate, by the model as screened, and at its end.

    Args:
        calibrations: At least one; of a size there may be several, of all parameters and of few.
        references: Known MSEs, drawn as lines; may be empty.
        path: Where the PNG goes.
        mse_unit: Unit of the MSE, e.g. "K²".
        footnote: Small print.

    Returns:
        The path.
    """
    ordered = sorted(calibrations, key=lambda c: c.n_train)
    finals = [c.mse_polished for c in ordered]
    cheapest = min(ordered, key=lambda c: c.calls_paper)
    least, most = significant(min(finals)), quantity(max(finals), mse_unit)
    is_one = least == significant(max(finals))
    span = f"an MSE of {most}" if is_one else f"{least} to {most}"
    final = "calibrated" if any(c.is_adaptive for c in ordered) else "polished"
    ends = "Polishing ends" if final == "polished" else "All end"
    title = f"{ends} at {span}; the cheapest way takes {count(cheapest.calls_paper)} model calls"
    rows = np.array([[c.mse_surrogate, c.mse_screened, c.mse_polished] for c in ordered])
    known = np.append(rows.ravel(), [r.mse for r in references])
    with drawing(path, title=title, height_in=3.9, footnote=footnote) as figure:
        axes = figure.subplots()
        axes.set_xticks(range(len(ordered)), [_tick(c) for c in ordered])
        axes.set_xlim(-0.6, len(ordered) - 0.4)
        low, high = log_limits(known)
        decimal_log(axes, low / (high / low) ** 0.12, high)
        axes.grid(visible=False, axis="x")
        for reference in references:
            axes.axhline(reference.mse, color=MUTED, linewidth=0.9, linestyle=(0, (5, 3)), zorder=1)
        for place, c in enumerate(ordered):
            _draw_size(axes, place, c)
        axes.set_xlabel("training simulations (above each: model calls that found the parameters)")
        axes.set_ylabel(axis_label("MSE", mse_unit))
        labels = [
            EndLabel(last_finite(rows[:, 0]), "by the surrogate", SURROGATE),
            EndLabel(last_finite(rows[:, 1]), "by the model,\nas screened", SCREENED),
            EndLabel(last_finite(rows[:, 2]), final, POLISHED),
        ]
        labels += [EndLabel(r.mse, r.label, MUTED) for r in references]
        end_labels(axes, labels)
    return path


def _tick(c: CalibrationRecord) -> str:
    few = "" if c.n_free is None else f"\n{count(c.n_free, 'parameter')}"
    return ("adaptive" if c.is_adaptive else str(c.n_train)) + few


def _draw_size(axes: Axes, place: int, c: CalibrationRecord) -> None:
    finite = [v for v in (c.mse_surrogate, c.mse_screened, c.mse_polished) if math.isfinite(v)]
    axes.plot([place] * 2, [min(finite), max(finite)], color=FAINT, linewidth=4, zorder=1)
    axes.plot(
        place, c.mse_surrogate, marker="o", markersize=7, color="white", markeredgecolor=SURROGATE, zorder=3
    )
    if math.isfinite(c.mse_screened):
        axes.plot(place, c.mse_screened, marker="D", markersize=6.5, color=SCREENED, zorder=4)
    axes.plot(place, c.mse_polished, marker="o", markersize=7.5, color=POLISHED, zorder=5)
    axes.annotate(
        f"{count(c.calls_paper)}",
        (place, 0.015),
        xycoords=("data", "axes fraction"),
        ha="center",
        fontsize=8.5,
        color=INK,
    )
