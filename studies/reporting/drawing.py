"""Pictures as data: panels of series, written as CSV, as a Vega-Lite specification, and as a picture.

The page draws the specification in the browser, where it zooms and shows values; MLflow gets an SVG of it,
which is made in half the time, and the pages of the documentation a PNG.
"""

from __future__ import annotations

import base64
import contextlib
import csv
import io
import json
import os
import resource
import subprocess
import sys
import textwrap
import threading
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import cycle, repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from simulation.arrays import FloatArray
from simulation.case import KnownError
from simulation.errors import MachineError
from simulation.time_unit import TimeUnit, unit_for
from simulation.whole_file import whole_file
from studies.words.wording import significant

# Blue and orange differ in every common kind of color vision; a color means the same in all pictures.
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
SERIES = ("#2a6a9e", "#d27f2b", "#3f9a8c", "#8b6bae", "#c3a23c", "#b9566b")
FEW_TO_MANY = (
    "#e0a458", "#cb8569", "#b5657a", "#935985", "#75508a", "#5b4a8b", "#47437a", "#323c69", "#1d3557",
)  # fmt: skip
"""Colors of training-set sizes, light for few simulations; as many as the paper has sizes."""

LOG: Mapping[str, Any] = {"type": "log", "nice": False, "padding": 20}
LOG2: Mapping[str, Any] = {**LOG, "base": 2}
BETWEEN_BOUNDS: Mapping[str, Any] = {"domain": [0.0, 1.0], "nice": False}

HOLLOW: Mapping[str, Any] = {"filled": False, "size": 70, "strokeWidth": 2, "opacity": 1}
DIAMOND: Mapping[str, Any] = {"filled": True, "shape": "diamond", "size": 80, "opacity": 1}
"""Points that stand out: the surrogate's own error, the model's."""

WIDTH = 640
"""Width of the panels of a row together. [CSS pixel]"""
PIXELS_PER_UNIT = 1.5
"""Pixels of the PNG per CSS pixel."""

_CONFIG: Mapping[str, Any] = {
    "font": "Helvetica, Arial, sans-serif",
    "background": "white",
    "customFormatTypes": True,
    "view": {"stroke": None},
    "title": {"anchor": "start", "fontSize": 12, "fontWeight": "normal"},
    "axis": {"gridColor": "#e9ecee", "labelLimit": 110, "titleFontWeight": "normal"},
    "axisY": {"minExtent": 42},
    "legend": {"labelLimit": 230, "orient": "bottom", "symbolOpacity": 1, "title": None},
}


@dataclass(frozen=True)
class Axis:
    """An axis: its label, its scale in Vega-Lite's words, its ticks; one of names keeps their order."""

    label: str
    scale: Mapping[str, Any] = field(default_factory=dict)
    is_of_names: bool = False
    ticks: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Series:
    """What is drawn alike in one panel: a line, points, or areas.

    Without `y`, a rectangle or rule goes from the bottom to the top; without `x`, from left to right.

    Attributes:
        name: For the legend; no two of a panel have the same.
        color: Hexadecimal.
        x: Numbers, or names on an axis of names. Shape (m,).
        y: The same. Shape (m,).
        mark: Vega-Lite's mark: "line", "point", "rect" or "rule".
        style: Vega-Lite's properties of the mark.
        x_end: Other end of a rectangle or rule. Shape (m,).
        low: Lower end of a band, or of a rectangle. Shape (m,).
        high: Upper end. Shape (m,).
        line: Which line a point belongs to, where a series has several. Shape (m,).
        text: Written below each point. Shape (m,).
        share: Opacity of each rectangle, from 0 to 1. Shape (m,).
        is_named: Whether the legend has it.
    """

    name: str
    color: str
    x: ArrayLike | None = None
    y: ArrayLike | None = None
    mark: str = "line"
    style: Mapping[str, Any] = field(default_factory=dict)
    x_end: ArrayLike | None = None
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    line: ArrayLike | None = None
    text: ArrayLike | None = None
    share: ArrayLike | None = None
    is_named: bool = True

    def columns(self) -> dict[str, Sequence[object]]:
        """Return its values by the names of the file's columns, all of one length."""
        named = {name: getattr(self, name) for name in _COLUMNS}
        known = {name: np.atleast_1d(values) for name, values in named.items() if values is not None}
        length = max(len(values) for values in known.values())
        return {name: np.broadcast_to(values, length).tolist() for name, values in known.items()}


_COLUMNS = ("x", "y", "x_end", "low", "high", "line", "text", "share")


@dataclass(frozen=True)
class Panel:
    """One pair of axes with what is drawn in it, the lowest first; its name is unique in the picture."""

    name: str
    x: Axis
    y: Axis
    series: Sequence[Series]
    height: int = 200
    has_legend: bool = True


@dataclass(frozen=True)
class Figure:
    """A picture: panels below each other, or beside each other in so many columns.

    Attributes:
        title: What the picture shows.
        panels: From left to right, then downward.
        columns: Panels per row; a narrow page has one.
        shows_names: Whether the names of the panels stand above them.
        caption: What stands below it on the page.
    """

    title: str
    panels: tuple[Panel, ...]
    columns: int = 1
    shows_names: bool = False
    caption: str = ""

    def to_csv(self) -> str:
        """Write the values of all series, one row each; what is not finite is left empty."""
        every = [(panel.name, one.name, one.columns()) for panel in self.panels for one in panel.series]
        header = [name for name in _COLUMNS if any(name in columns for *_, columns in every)]
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(["panel", "series", *header])
        for panel, series, columns in every:
            cells = [map(_cell, columns[name]) if name in columns else repeat("") for name in header]
            writer.writerows([panel, series, *row] for row in zip(*cells, strict=False))
        return text.getvalue()

    def specification(self, *, with_values: bool = False) -> dict[str, Any]:
        """Return the Vega-Lite specification without title, its data within as CSV.

        Args:
            with_values: Whether the value next to the pointer is shown.
        """
        types = dict.fromkeys(("x_end", "low", "high", "share"), "number") | {"series": "string"}
        for axis in ("x", "y"):
            of_names = {getattr(panel, axis).is_of_names for panel in self.panels}
            # What is not parsed stays a text, and a gap would be drawn as 0.
            if len(of_names) == 1:
                types[axis] = "string" if of_names.pop() else "number"
        # Panels over the same quantity zoom together.
        groups: dict[str, list[str]] = {}
        for k, panel in enumerate(self.panels):
            if not panel.x.is_of_names:
                groups.setdefault(f"x {panel.x.label}", []).append(f"panel_{k}")
            if not panel.y.is_of_names:
                groups[f"y {k}"] = [f"panel_{k}"]
        return {
            "$schema": "https://vega.github.io/schema/vega-lite/v6.json",
            "config": {**_CONFIG, "legend": {**_CONFIG["legend"], "columns": 4 // self.columns}},
            "data": {"values": self.to_csv(), "format": {"type": "csv", "parse": types}},
            "concat": [self._panel(k, panel, with_values=with_values) for k, panel in enumerate(self.panels)],
            "columns": self.columns,
            "spacing": 12,
            "resolve": {"scale": {"color": "independent"}, "legend": {"color": "independent"}},
            "params": [
                {
                    "name": f"zoom_{k}",
                    # A wheel alone scrolls the page.
                    "select": {"type": "interval", "encodings": [key[0]], "zoom": "wheel![event.ctrlKey]"},
                    "bind": "scales",
                    "views": views,
                }
                for k, (key, views) in enumerate(groups.items())
            ],
        }

    def _panel(self, place: int, panel: Panel, *, with_values: bool) -> dict[str, Any]:
        colors = {
            "domain": [one.name for one in panel.series],
            "range": [one.color for one in panel.series],
        }
        legend = {"values": [one.name for one in panel.series if one.is_named]}
        color = {"scale": colors, "legend": legend if panel.has_legend and legend["values"] else None}
        layers = [layer for one in panel.series for layer in _layers(panel, one, color)]
        # Vega-Lite zooms a layer that has both axes.
        next(one for one in layers if {"x", "y"} <= set(one["encoding"]))["name"] = f"panel_{place}"
        if with_values:
            layers.append(_values(panel, f"near_{place}"))
        return {
            **({"title": panel.name} if self.shows_names else {}),
            "width": WIDTH // self.columns,
            "height": panel.height,
            "transform": [{"filter": {"field": "panel", "equal": panel.name}}],
            "layer": layers,
        }


def _cell(value: object) -> object:
    if isinstance(value, float):
        return f"{value:.7g}" if np.isfinite(value) else ""
    return value


def _layers(panel: Panel, series: Series, color: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the layers of a series: its band, its marks, and its text."""
    of_series = {"transform": [{"filter": {"field": "series", "equal": series.name}}]}
    x, y = _position("x", panel.x), _position("y", panel.y)
    colored = {"color": {"datum": series.name, **color}}
    mark = {"type": series.mark, "clip": True, **series.style}
    parts = (
        (series.x, "x", x),
        (series.y, "y", y),
        (series.x_end, "x2", {"field": "x_end"}),
        (series.line, "detail", {"field": "line"}),
        (series.share, "opacity", {"field": "share", "type": "quantitative", "scale": None}),
    )
    both = {name: encoding for values, name, encoding in parts if values is not None}
    found: list[dict[str, Any]] = []
    if series.low is not None:
        ends = {"y": {**y, "field": "low"}, "y2": {"field": "high"}}
        kind = "rect" if series.mark == "rect" else "area"
        is_whole = series.y is None
        band = {"type": kind, "clip": True, "opacity": 1.0 if is_whole else 0.25, **series.style}
        found.append({**of_series, "mark": band, "encoding": {**both, **colored, **ends}})
        if is_whole:
            return found
    found.append({**of_series, "mark": mark, "encoding": {**both, **colored}})
    if series.text is not None:
        written = {"type": "text", "dy": 13, "fontSize": 10, "color": series.color, "clip": True}
        found.append({**of_series, "mark": written, "encoding": {**both, "text": {"field": "text"}}})
    return found


def _values(panel: Panel, selection: str) -> dict[str, Any]:
    """Return a layer of points that are seen, with their values, only next to the pointer."""
    x, y = _position("x", panel.x), _position("y", panel.y)
    # Next to the pointer Vega-Lite finds a text only as a number with a format: that of charts.js keeps it.
    number, text = (
        {"type": "quantitative", "format": ",.4~g"},
        {"type": "quantitative", "formatType": "asText"},
    )
    shown = [
        {"field": "series", "title": " ", **text},
        {"field": "x", "title": panel.x.label or " ", **(text if panel.x.is_of_names else number)},
        {"field": "y", "title": panel.y.label or "  ", **(text if panel.y.is_of_names else number)},
    ]
    select = {"type": "point", "nearest": True, "on": "pointerover", "clear": "pointerout"}
    return {
        "transform": [{"filter": "isValid(datum.x) && isValid(datum.y) && datum.x !== '' && datum.y !== ''"}],
        "params": [{"name": selection, "select": select}],
        "mark": {"type": "point", "filled": True, "color": INK, "clip": True},
        "encoding": {
            "x": x,
            "y": y,
            "opacity": {"condition": {"param": selection, "empty": False, "value": 1}, "value": 0},
            "tooltip": shown,
        },
    }


def _position(name: str, axis: Axis) -> dict[str, Any]:
    if axis.is_of_names:
        angle = {"labelAngle": -40} if name == "x" else {}
        return {
            "field": name, "type": "nominal", "title": axis.label or None, "sort": None,
            "axis": {**angle, "grid": False},
        }  # fmt: skip
    shown: dict[str, Any] = {"format": ",~g"} if axis.scale.get("type") == "log" else {}
    if axis.ticks:
        shown["values"] = axis.ticks
    return {
        "field": name, "type": "quantitative", "title": axis.label or None,
        "scale": axis.scale if axis.scale else {"zero": False},
        "axis": {"labelOverlap": True, "tickCount": 6, **shown},
    }  # fmt: skip


class _Drawer:
    """A process that draws one picture after the other for this one, and may die of it."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "studies.reporting.drawing_process"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            # Ctrl-C reaches only the process that decides what it means.
            start_new_session=True,
        )
        self.close = weakref.finalize(self, _end, self._process, os.getpid())

    def answer(self, request: bytes) -> dict[str, Any] | None:
        """Return what it answers; None where it has ended."""
        given, answers = self._process.stdin, self._process.stdout
        assert given is not None
        assert answers is not None
        with contextlib.suppress(BrokenPipeError):
            given.write(request + b"\n")
            given.flush()
            if (line := answers.readline()).endswith(b"\n"):
                answer: dict[str, Any] = json.loads(line)
                return answer
        return None

    def how_it_ended(self) -> str:
        """Return how it has ended, and forget it."""
        code = self._process.wait()
        self.close()
        return f"signal {-code}" if code < 0 else f"exit code {code}"


def _end(process: subprocess.Popen[bytes], owner: int) -> None:
    """End a process that draws, unless this is a fork of the one that started it."""
    if os.getpid() == owner:
        process.kill()
        process.wait()
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(BrokenPipeError):
                pipe.close()


_lock = threading.Lock()
_idle: dict[int, _Drawer] = {}  # by the process that it draws for: a fork of that one has its own


def drawn(kind: str, specification: Mapping[str, Any] | None = None) -> str:
    """Draw in a process of its own, which may die of it.

    Args:
        kind: "svg" or "png"; "library" for the programs that draw in a browser.
        specification: In Vega-Lite.

    Returns:
        A text; for "png" in base64.

    Raises:
        MachineError: The process fails.
    """
    asked = {"kind": kind, "scale": PIXELS_PER_UNIT, "specification": specification}
    request, how = json.dumps(asked).encode(), ""
    with _lock:
        # One that has waited for long has ended; a new one has not.
        for next_one in (lambda: _idle.pop(os.getpid(), None), _Drawer):
            # It is out of the table while it draws: Ctrl-C may come between a request and its answer.
            if drawer := next_one():
                if answer := drawer.answer(request):
                    _idle[os.getpid()] = drawer
                    if "drawn" in answer:
                        return str(answer["drawn"])
                    how = answer["error"]
                    break
                how = drawer.how_it_ended()
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    remedy = "" if limit == resource.RLIM_INFINITY else "; its memory is limited: ulimit -v unlimited"
    raise MachineError(f"a picture cannot be drawn ({shortened(how, 200)}){remedy}")


def write_picture(figure: Figure, path: Path, *, footnote: str = "") -> Path:
    """Draw a figure into a file, which is replaced in one step.

    Args:
        figure: What to draw.
        path: Where the picture goes, an SVG or a PNG by its name; the folder is made.
        footnote: Small print below the title, e.g. the label of a study.

    Returns:
        The path.

    Raises:
        MachineError: The library that draws fails here, as where memory is limited.
    """
    title = {
        "text": textwrap.wrap(figure.title, 90), "subtitle": textwrap.wrap(footnote, 120, max_lines=2),
        "fontWeight": "bold", "fontSize": 13, "subtitleColor": MUTED, "subtitleFontSize": 10, "offset": 12,
    }  # fmt: skip
    kind = path.suffix.removeprefix(".")
    content = drawn(kind, {**figure.specification(), "title": title})
    with whole_file(path) as file:
        file.write(base64.b64decode(content) if kind == "png" else content.encode())
    return path


def size_colors(sizes: Sequence[int]) -> dict[int, str]:
    """Return a color per training-set size, from light for few simulations to dark for many."""
    places = np.linspace(0, len(FEW_TO_MANY) - 1, max(len(sizes), 2)).round().astype(int)
    return {size: FEW_TO_MANY[place] for size, place in zip(sorted(sizes), places, strict=False)}


def reference_lines(references: Sequence[KnownError]) -> list[Series]:
    """Return known MSEs as dashed lines."""
    colors = cycle((MUTED, INK, SERIES[2]))
    return [
        Series(
            f"{significant(known.mse)} {shortened(known.label, 28)}", color, y=[known.mse], mark="rule",
            style={"strokeDash": [5, 3]},
        )
        for known, color in zip(references, colors, strict=False)
    ]  # fmt: skip


def shortened(text: str, n_characters: int = 24) -> str:
    """Cut a name that comes from a file to a length that leaves room for the picture."""
    return text if len(text) <= n_characters else text[: n_characters - 1] + "…"


def with_gaps(time: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return samples with NaN where they lie further apart than usual, so that a line breaks there.

    Args:
        time: Sample times. Shape (m,).
        values: Samples. Shape (m,).
    """
    steps = np.diff(time)
    # Most steps of an irregular recording are no gaps.
    usual = np.quantile(steps, 0.75) if len(steps) else 0.0
    gaps = np.flatnonzero(steps > 1.5 * usual) + 1
    return np.insert(time, gaps, time[gaps - 1]), np.insert(values, gaps, np.nan)


def time_axis(time: FloatArray) -> tuple[Axis, TimeUnit]:
    """Return an axis in the unit that suits the end of the times, and the unit.

    Args:
        time: Times. Shape (t,). [s]
    """
    unit = unit_for(float(time[-1]))
    first, last = unit.of_seconds(time[[0, -1]]).tolist()
    ends = [first, last if last > first else first + 1.0]
    return Axis(f"time [{unit.symbol}]", {"domain": ends, "nice": False}), unit
