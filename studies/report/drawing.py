"""The look of every picture: palette, canvas, direct labels, and PNG files with repeatable bytes."""

from __future__ import annotations

import math
import re
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

from simulation.time_unit import TimeUnit, unit_for
from simulation.whole_file import whole_file
from studies.report.records import Floats

# Every common kind of color vision tells blue from orange; a color means the same in all pictures.
INK = "#2f3437"
MUTED = "#858c92"
FAINT = "#d5d9dc"
MEASURED = "#8d9499"
SURROGATE = "#8b6bae"
BEST_SURROGATE = "#56397a"
SCREENED = "#d27f2b"
POLISHED = "#2a6a9e"
TRAINING = "#dfe8ef"
SIMULATED = "#7fa5c1"
FAILED = "#b9566b"
SERIES = ("#2a6a9e", "#d27f2b", "#3f9a8c", "#8b6bae", "#c3a23c", "#b9566b")

WIDTH_IN = 8.0
DPI = 150

_STYLE: dict[str, Any] = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.5,
    "axes.linewidth": 0.8,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 9.5,
    "axes.titlecolor": INK,
    "axes.unicode_minus": True,
    "figure.facecolor": "white",
    "font.family": ["DejaVu Sans"],
    "font.size": 9.5,
    "grid.color": "#e9ecee",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.6,
    "lines.solid_capstyle": "round",
    "text.color": INK,
    # Names come from files: a dollar sign in one of them is a dollar sign.
    "text.parse_math": False,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 9,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 9,
}


@contextmanager
def drawing(path: Path, *, title: str, height_in: float, footnote: str = "") -> Iterator[Figure]:
    """Open a figure, and write it as a PNG when the block ends well.

    Args:
        path: Where to; the folder is made. The file is replaced in one step.
        title: A sentence that says what the picture shows.
        height_in: Height without the lines that a long title adds. [inch]
        footnote: Small print below, e.g. a case's note.
    """
    # A number stays on the line of its unit.
    lines = textwrap.wrap(re.sub(r"(\d) (?=[^\d\s]{1,3}\b)", "\\1\u00a0", title), 82, max_lines=3) or [""]
    notes = textwrap.wrap(footnote, 130, max_lines=2, placeholder=" …")
    with style.context(_STYLE, after_reset=True):
        height = height_in + 0.2 * (len(lines) - 1) + 0.14 * len(notes)
        figure = Figure(figsize=(WIDTH_IN, height), dpi=DPI, layout="constrained")
        canvas = FigureCanvasAgg(figure)
        engine = figure.get_layout_engine()
        if isinstance(engine, ConstrainedLayoutEngine):
            engine.set(w_pad=0.1, h_pad=0.07)
        figure.suptitle("\n".join(lines), x=0.012, ha="left", fontsize=11, fontweight="bold", color=INK)
        if notes:
            figure.supxlabel("\n".join(notes), x=0.012, ha="left", fontsize=7.5, color=MUTED)
        yield figure
        _save(canvas, path)


def _save(canvas: FigureCanvasAgg, path: Path) -> None:
    with whole_file(path) as file, warnings.catch_warnings():
        # A title in a script that the font lacks is drawn with boxes; that is no reason to fail.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        # Figure.savefig would draw it twice for the same picture.
        canvas.print_png(file, metadata={"Software": None})  # type: ignore[no-untyped-call]


def decimal_log(axes: Axes, lower: float, upper: float) -> None:
    """Make the vertical axis logarithmic, with as many plain decimal numbers as are readable."""
    axes.set_yscale("log")
    axes.set_ylim(lower, upper)
    axis = axes.yaxis
    decades = math.log10(upper / lower)
    ticks = {
        0.3: (1.0, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0),
        1.0: (1.0, 1.5, 2.0, 3.0, 5.0, 7.0),
        2.5: (1.0, 2.0, 5.0),
        math.inf: (1.0,),
    }
    subs = next(subs for most, subs in ticks.items() if decades < most)
    axis.set_major_locator(LogLocator(base=10.0, subs=subs))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axis.set_minor_formatter(NullFormatter())


def category_log(axes: Axes, sizes: Sequence[int]) -> list[int]:
    """Make the horizontal axis logarithmic with a tick at each of some sizes and nowhere else.

    Returns:
        The sizes that have room for a label.
    """
    axes.set_xscale("log")
    # The labels of, say, 1024, 1536 and 2048 would run into each other: powers of two go first.
    kept: list[int] = []
    for size in sorted(sizes, key=lambda n: (n & (n - 1) != 0, n)):
        if all(max(size, other) > 1.45 * min(size, other) for other in kept):
            kept.append(size)
    labels = [str(size) if size in kept else "" for size in sizes]
    axes.xaxis.set_minor_locator(NullLocator())
    axes.set_xticks(list(sizes), labels)
    axes.xaxis.set_minor_formatter(NullFormatter())
    return kept


def log_limits(values: Floats, *, pad: float = 0.08) -> tuple[float, float]:
    """Return limits around the positive finite values, padded by a fraction of their logarithmic range."""
    usable = values[np.isfinite(values) & (values > 0)]
    if usable.size == 0:
        return 0.1, 10.0
    low, high = math.log10(usable.min()), math.log10(usable.max())
    margin = max(pad * (high - low), 0.06)
    return 10.0 ** (low - margin), 10.0 ** (high + margin)


@dataclass(frozen=True)
class EndLabel:
    """A word at the right edge of a picture, at the height of what it names."""

    value: float
    text: str
    color: str


def end_labels(axes: Axes, labels: Sequence[EndLabel], *, size: float = 8.5) -> None:
    """Write labels at the right edge of axes with settled limits, moved apart where they would overlap."""
    shown = [
        EndLabel(label.value, _folded(label.text), label.color)
        for label in labels
        if math.isfinite(label.value)
    ]
    heights = [
        float(axes.transLimits.transform(axes.transScale.transform((axes.get_xlim()[1], label.value)))[1])
        for label in shown
    ]
    box = axes.get_position()
    figure = axes.get_figure(root=True)
    axes_in = (figure.get_figheight() if figure else 4.0) * box.height
    gaps = [1.3 * size / 72.0 / axes_in * (label.text.count("\n") + 1) for label in shown]
    for label, height in zip(shown, spread_apart(heights, gaps), strict=True):
        axes.annotate(
            label.text,
            xy=(1.0, height),
            xycoords="axes fraction",
            xytext=(5, 0),
            textcoords="offset points",
            va="center",
            fontsize=size,
            color=label.color,
            annotation_clip=False,
        )


def _folded(text: str) -> str:
    lines = [line for part in text.split("\n") for line in textwrap.wrap(part, 24)]
    return "\n".join([*lines[:2], shortened(" ".join(lines[2:]))] if len(lines) > 3 else lines)


def shortened(text: str, n_characters: int = 24) -> str:
    """Cut a name that comes from a file to a length that leaves room for the picture."""
    return text if len(text) <= n_characters else text[: n_characters - 1] + "…"


def spread_apart(heights: Sequence[float], gaps: Sequence[float]) -> list[float]:
    """Move positions between 0 and 1 apart, as little as needed and in their order, until all have room.

    Args:
        heights: Wished positions. [1]
        gaps: Room each one needs, centered on it. [1]
    """
    # Blocks of labels that touch: each sits where its members' wishes average out (pool adjacent violators).
    blocks: list[tuple[list[int], float]] = []
    for i in sorted(range(len(heights)), key=lambda i: heights[i]):
        members = [i]
        center = _center(members, heights, gaps)
        while blocks:
            below, below_center = blocks[-1]
            room = (sum(gaps[j] for j in below) + sum(gaps[j] for j in members)) / 2
            if center - below_center >= room:
                break
            blocks.pop()
            members = below + members
            center = _center(members, heights, gaps)
        blocks.append((members, center))
    spread = [0.0] * len(heights)
    for members, center in blocks:
        low = center - sum(gaps[i] for i in members) / 2
        for i in members:
            spread[i] = low + gaps[i] / 2
            low += gaps[i]
    return spread


def _center(members: Sequence[int], heights: Sequence[float], gaps: Sequence[float]) -> float:
    """Return the wished center of a block of labels, kept inside the axes where the block fits."""
    half = sum(gaps[i] for i in members) / 2
    wish = sum(heights[i] for i in members) / len(members)
    return min(max(wish, half), 1.0 - half) if half < 0.5 else 0.5


def line_with_gaps(axes: Axes, time: Floats, values: Floats, **style: Any) -> None:
    """Draw a line through samples, broken where they lie further apart than usual; dots where it is broken.

    Args:
        axes: Where to.
        time: Sample times. Shape (m,). [unit of the axis]
        values: Samples. Shape (m,).
        style: Color, width and the like of the line.
    """
    steps = np.diff(time)
    # Most steps of an irregular recording are no gaps.
    usual = np.quantile(steps, 0.75) if len(steps) else 0.0
    gaps = np.flatnonzero(steps > 1.5 * usual) + 1
    if len(gaps) or len(time) == 1:
        # A sample between two gaps has no line.
        style |= {"marker": ".", "markersize": 2.5 * style.get("linewidth", 1.0)}
    axes.plot(np.insert(time, gaps, np.nan), np.insert(values, gaps, np.nan), **style)


def time_axis(axes: Axes, time: Floats) -> TimeUnit:
    """Fit the horizontal axis to times, label it in the unit that suits their end, and return the unit.

    Periods are told in the same one (`period_text`).

    Args:
        axes: Whose axis.
        time: Times. Shape (t,). [s]
    """
    unit = unit_for(float(time[-1]))
    first, last = (float(end) for end in unit.of_seconds(time[[0, -1]]))
    axes.set_xlim(first, last if last > first else first + 1.0)
    axes.set_xlabel(f"time [{unit.symbol}]")
    return unit
