"""The picture of an adaptive calibration: the best MSE over model calls, from the first design on."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from studies.report.data import Reference
from studies.report.drawing import (
    INK,
    MUTED,
    POLISHED,
    TRAINING,
    EndLabel,
    decimal_log,
    drawing,
    end_labels,
    log_limits,
)
from studies.report.records import CalibrationRecord
from studies.report.wording import axis_label, count, quantity, significant


def convergence_figure(
    calibration: CalibrationRecord,
    references: Sequence[Reference],
    path: Path,
    *,
    mse_unit: str,
    footnote: str = "",
) -> Path:
    """Draw the best MSE over the calls of an adaptive calibration, its first design shaded.

    Args:
        calibration: The calibration to show.
        references: Known MSEs, drawn as lines; may be empty.
        path: Where the PNG goes.
        mse_unit: Unit of the MSE, e.g. "K²".
        footnote: Small print.

    Returns:
        The path.
    """
    final, calls, best = calibration.mse_polished, calibration.history_calls, calibration.history_mse
    n_start, last = int(calls[0]), int(calls[-1])
    n_free, n_known = calibration.n_free, calibration.n_known
    start = "from no initial guess" if n_free is None else f"with {count(n_free, 'parameter')}"
    came_from = f"{count(n_start - calibration.n_before)} rows that fill the box"
    if n_known:
        came_from = count(n_known, "stored simulation")
        start = f"{'' if n_free is None else f'{start}, '}begun with {came_from}"
    title = f"{count(last, 'model call')} reach an MSE of {quantity(final, mse_unit)} {start}"
    with drawing(path, title=title, height_in=3.7, footnote=footnote) as figure:
        axes = figure.subplots()
        axes.set_xlim(0.0, 1.01 * max(last, 1))
        decimal_log(
            axes, *log_limits(np.append(best[np.isfinite(best)], [final, *(r.mse for r in references)]))
        )
        axes.axvspan(0.0, n_start, color=TRAINING, linewidth=0, zorder=0)
        for reference in references:
            axes.axhline(reference.mse, color=MUTED, linewidth=0.9, linestyle=(0, (5, 3)), zorder=1)
        axes.step(calls, best, where="post", color=POLISHED, zorder=3)
        if math.isfinite(best[0]):
            axes.plot(n_start, best[0], marker="o", markersize=4.5, color=POLISHED, zorder=4)
            axes.annotate(
                f"{significant(float(best[0]))}, the best of {came_from}",
                (n_start, float(best[0])),
                (8, 3),
                textcoords="offset points",
                fontsize=8.5,
                color=INK,
            )
        axes.set_xlabel("model calls")
        axes.set_ylabel(axis_label("best MSE", mse_unit))
        labels = [EndLabel(final, f"{significant(final)} calibrated", POLISHED)]
        labels += [EndLabel(r.mse, f"{significant(r.mse)} {r.label}", MUTED) for r in references]
        end_labels(axes, labels)
    return path
