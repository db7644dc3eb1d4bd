"""The look of every picture: palette, canvas, legends, and PNG files with repeatable bytes."""

from __future__ import annotations

import re
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, to_hex
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from simulation.case import KnownError
from simulation.time_unit import TimeUnit, unit_for
from simulation.whole_file import whole_file
from studies.report.records import Floats
from studies.report.wording import significant

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
_FEW_TO_MANY = LinearSegmentedColormap.from_list("sizes", ["#e0a458", "#b5657a", "#5b4a8b", "#1d3557"])
SERIES = ("#2a6a9e", "#d27f2b", "#3f9a8c", "#8b6bae", "#c3a23c", "#b9566b")

WIDTH_IN = 8.0
DPI = 150

_STYLE: dict[str, Any] = {
    "axes.edgecolor": MUTED,
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9.5,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 9.5,
    "axes.titlecolor": INK,
    "font.size": 9.5,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "grid.color": "#e9ecee",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "lines.linewidth": 1.6,
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
    with style.context(_STYLE, after_reset=True), warnings.catch_warnings():
        # A title in a script that the font lacks is drawn with boxes; that is no reason to fail.
        warnings.filterwarnings("ignore", message="Glyph .* missing from")
        # Of a logarithmic axis around a single power of ten; Matplotlib widens it, as it should.
        warnings.filterwarnings("ignore", message="Attempting to set identical low and high")
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
        with whole_file(path) as file:
            # Figure.savefig would draw it twice for the same picture.
            canvas.print_png(file, metadata={"Software": None})  # type: ignore[no-untyped-call]


def decimal_log(axes: Axes) -> None:
    """Make the vertical axis logarithmic, with as many plain decimal numbers as are readable."""

    def label(value: float, _: object) -> str:
        low, high = axes.get_ylim()
        shown = "1" if high > 300.0 * low else "125" if high > 4.0 * low else "123456789"
        return f"{value:,g}" if f"{value:e}"[0] in shown else ""

    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(base=10.0, subs="all"))
    axes.yaxis.set_major_formatter(FuncFormatter(label))
    axes.yaxis.set_minor_formatter(NullFormatter())


def sizes_axis(axes: Axes) -> None:
    """Make the horizontal axis logarithmic to the base 2, with plain numbers."""
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def size_colors(sizes: Sequence[int]) -> dict[int, str]:
    """Return a color per training-set size, from light for few simulations to dark for many."""
    places = np.linspace(0.0, 1.0, max(len(sizes), 2))
    return {size: to_hex(_FEW_TO_MANY(place)) for size, place in zip(sorted(sizes), places, strict=False)}


def legend(axes: Axes) -> None:
    """Name what has a label, beside the axes at their right edge."""
    if axes.get_legend_handles_labels()[1]:
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.0)


def mse_lines(axes: Axes, references: Sequence[KnownError]) -> None:
    """Draw known MSEs as dashed lines."""
    for reference, dashes in zip(references, cycle(((5, 3), (1, 2), (8, 2, 1, 2))), strict=False):
        axes.axhline(
            reference.mse, color=MUTED, linewidth=0.9, linestyle=(0, dashes), zorder=1,
            label=f"{significant(reference.mse)} {shortened(reference.label)}",
        )  # fmt: skip


def shortened(text: str, n_characters: int = 24) -> str:
    """Cut a name that comes from a file to a length that leaves room for the picture."""
    return text if len(text) <= n_characters else text[: n_characters - 1] + "…"


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

    Periods are written in the same one (`period_text`).

    Args:
        axes: Whose axis.
        time: Times. Shape (t,). [s]
    """
    unit = unit_for(float(time[-1]))
    first, last = (float(end) for end in unit.of_seconds(time[[0, -1]]))
    axes.set_xlim(first, last if last > first else first + 1.0)
    axes.set_xlabel(f"time [{unit.symbol}]")
    return unit
