"""Pictures of simulated sets: do they cover the measurement (Fig. 4) and the parameters (sec. 2.3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection

from studies.report.drawing import (
    FAILED,
    INK,
    MUTED,
    POLISHED,
    SIMULATED,
    EndLabel,
    drawing,
    end_labels,
    line_with_gaps,
    shortened,
    time_axis,
)
from studies.report.findings import enclosed_fraction, good_rows
from studies.report.records import Floats, MeasuredSeries, ParameterBox
from studies.report.records_model import CoverageSet
from studies.report.wording import axis_label, count, percent, shown_unit


@dataclass(frozen=True)
class MarkedPoint:
    """A parameter set to mark among the sampled ones: its name and its values, shape (p,)."""

    name: str
    theta: Floats


def coverage_figure(
    measurement: MeasuredSeries, coverage: CoverageSet, path: Path, *, footnote: str = ""
) -> Path:
    """Draw all trajectories of a set with the measurement over them (Fig. 4 of the paper).

    Args:
        measurement: What is to be covered.
        coverage: The simulated set; failed rows are left out.
        path: Where the PNG goes.
        footnote: Small print.

    Returns:
        The path.
    """
    good = good_rows(coverage)
    enclosed = enclosed_fraction(measurement, coverage)
    title = (
        f"{count(len(good), f'{coverage.name} trajectory', f'{coverage.name} trajectories')} "
        f"enclose {percent(enclosed)} of the measured values"
        if len(good)
        else f"No {coverage.name} simulation succeeded"
    )
    n_outputs = len(measurement.output_names)
    with drawing(path, title=title, height_in=0.6 + 3.2 * n_outputs, footnote=footnote) as figure:
        panels = figure.subplots(n_outputs, 1, sharex=True, squeeze=False)
        for output in range(n_outputs):
            axes = panels[output, 0]
            unit_of_time = time_axis(axes, measurement.time)
            _draw_bundle(axes, unit_of_time.of_seconds(measurement.time), good[:, :, output])
            measured = measurement.samples[output]
            measured_at = unit_of_time.of_seconds(measured.time)
            line_with_gaps(axes, measured_at, measured.values, color="white", linewidth=3.6, zorder=4)
            line_with_gaps(axes, measured_at, measured.values, color=INK, linewidth=1.8, zorder=5)
            axes.autoscale_view(scalex=False)
            name, unit = measurement.output_names[output], shown_unit(measurement.units[output])
            axes.set_ylabel(axis_label(shortened(name), shortened(unit)))
            axes.set_ylim(*axes.get_ylim())
            labels = [EndLabel(float(measured.values[-1]), "measured", INK)]
            if len(good):
                labels.append(
                    EndLabel(float(np.max(good[:, -1, output])), f"{len(good):,} simulated", SIMULATED)
                )
            end_labels(axes, labels)
        for axes in panels[:-1, 0]:
            axes.set_xlabel("")
    return path


def _draw_bundle(axes: Axes, time: Floats, rows: Floats) -> None:
    """Draw many trajectories, each the fainter the more there are. Shape of rows (n, t)."""
    if not len(rows):
        return
    segments = np.empty((*rows.shape, 2))
    segments[:, :, 0], segments[:, :, 1] = time, rows
    alpha = float(np.clip(60.0 / len(rows), 0.07, 0.6))
    axes.add_collection(
        LineCollection(list(segments), colors=SIMULATED, linewidths=0.8, alpha=alpha, zorder=2)
    )


def coverage_pairs_figure(
    parameters: ParameterBox,
    coverage: CoverageSet,
    path: Path,
    *,
    marked: Sequence[MarkedPoint] = (),
    footnote: str = "",
) -> Path:
    """Draw every pair of parameters of a set, each from its lower to its upper bound (sec. 2.3 of the paper).

    Args:
        parameters: Names and bounds.
        coverage: The sampled set; failed rows are marked with a cross.
        path: Where the PNG goes.
        marked: Parameter sets to mark, e.g. the polished one.
        footnote: Small print.

    Returns:
        The path.
    """
    names = [shortened(name) for name in parameters.names]
    p = len(names)
    unit = (coverage.theta - parameters.lower) / (parameters.upper - parameters.lower)
    failed = ~np.isfinite(coverage.y).all(axis=(1, 2))
    pairs = count(p * (p - 1) // 2, "pair")
    title = f"{count(len(unit), f'{coverage.name} sample')} over the whole box: {pairs} of {p} parameters"
    with drawing(path, title=title, height_in=8.0, footnote=footnote) as figure:
        # One axes with p x p cells: two hundred axes would take minutes to lay out.
        axes = figure.subplots()
        axes.set(xlim=(-0.05, p + 0.05), ylim=(p + 0.05, -0.05), aspect="equal")
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        axes.set_xticks(
            np.arange(p) + 0.5, names, rotation=45, ha="right", rotation_mode="anchor", fontsize=8
        )
        axes.set_yticks(np.arange(p) + 0.5, names, fontsize=8)
        axes.tick_params(length=0)
        _draw_cells(axes, p)
        _draw_histograms(axes, unit)
        size = float(np.clip(60.0 / max(len(unit), 1) ** 0.5, 0.6, 4.0)) * max(1.0, 14 / p) ** 0.5
        _draw_points(axes, unit[~failed], marker=".", size=size, color=SIMULATED, alpha=0.5)
        _draw_points(axes, unit[failed], marker="x", size=2.5, color=FAILED, alpha=1.0)
        for point, marker in zip(marked, "*DP^" * len(marked), strict=False):
            place = (point.theta - parameters.lower) / (parameters.upper - parameters.lower)
            _draw_points(axes, place[None, :], marker=marker, size=7.0, color=POLISHED, alpha=1.0)
        _explain(axes, p, marked, n_failed=int(failed.sum()))
    return path


def _draw_cells(axes: Axes, p: int) -> None:
    cells = []
    for row in range(p):
        for column in range(row + 1):
            x, y = column + 0.04, row + 0.04
            cells.append([(x, y), (x + 0.92, y), (x + 0.92, y + 0.92), (x, y + 0.92), (x, y)])
    axes.add_collection(LineCollection(cells, colors="#dfe3e6", linewidths=0.6, zorder=1))


def _place(cell: int, unit: Floats) -> Floats:
    return cell + 0.08 + 0.84 * unit


def _draw_points(axes: Axes, unit: Floats, *, marker: str, size: float, color: str, alpha: float) -> None:
    rows, columns = np.tril_indices(unit.shape[1], k=-1)
    x = np.concatenate([_place(int(c), unit[:, c]) for c in columns]) if len(columns) else np.empty(0)
    y = np.concatenate([_place(int(r), 1.0 - unit[:, r]) for r in rows]) if len(rows) else np.empty(0)
    edge = 0.8 if marker == "x" else 0.0
    axes.plot(
        x, y, linestyle="none", marker=marker, markersize=size, color=color, alpha=alpha, markeredgewidth=edge
    )


def _draw_histograms(axes: Axes, unit: Floats) -> None:
    for cell in range(unit.shape[1]):
        n, edges = np.histogram(unit[:, cell], bins=10, range=(0.0, 1.0))
        heights = 0.8 * n / max(int(n.max()), 1)
        left = _place(cell, edges[:-1])
        axes.bar(
            left,
            -heights,
            width=0.078,
            bottom=cell + 0.94,
            align="edge",
            color=POLISHED,
            alpha=0.35,
            linewidth=0,
        )


def _explain(axes: Axes, p: int, marked: Sequence[MarkedPoint], *, n_failed: int) -> None:
    """Say in the empty upper triangle how to read the cells."""
    lines = [
        ("each cell: one pair of parameters,", INK),
        ("both from lower to upper bound, linear", MUTED),
        ("diagonal: how often each tenth was drawn", MUTED),
    ]
    signs = zip("★◆✚▲" * len(marked), marked, strict=False)
    lines += [(f"{sign} {shortened(point.name)}", POLISHED) for sign, point in signs]
    lines += [(f"× {count(n_failed, 'failed simulation')}", FAILED)] if n_failed else []
    for number, (line, color) in enumerate(lines):
        axes.annotate(
            line,
            (0.995, 0.985),
            (0, -14.0 * number),
            xycoords="axes fraction",
            textcoords="offset points",
            ha="right",
            va="top",
            fontsize=9,
            color=color,
        )
