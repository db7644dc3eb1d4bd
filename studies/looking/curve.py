"""Curves as text: a plot of Braille dots, two by four to a character, with its axes."""

import math

import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT = 56, 8
"""Size of a plot without its axes. [characters]"""
STEEP = 8.0
"""A curve that falls to less than this part of its begin is drawn on a logarithmic axis."""
_DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
_BLANK = 0x2800


def plot(x: NDArray[np.float64], y: NDArray[np.float64], *, x_name: str, y_name: str) -> str:
    """Draw a curve; points that are not finite are left out.

    Args:
        x: Shape (n,).
        y: Shape (n,).
        x_name: what is on the horizontal axis.
        y_name: what is on the vertical axis, with its unit.

    Returns:
        Lines of text, empty where there are fewer than two points.
    """
    known = np.isfinite(x) & np.isfinite(y)
    x, y = np.asarray(x, dtype=np.float64)[known], np.asarray(y, dtype=np.float64)[known]
    if len(x) < 2 or x[0] == x[-1]:
        return ""
    is_log = bool(y.min() > 0.0 and y.max() > STEEP * y.min())
    values = np.log(y) if is_log else y
    at = np.linspace(x[0], x[-1], 2 * WIDTH)
    rows = _rows(np.interp(at, x, values))
    top, bottom = f"{y.max():.3g}", f"{y.min():.3g}"
    wide = max(len(top), len(bottom))
    labels = [top, *([""] * (HEIGHT - 2)), bottom]
    lines = [f"{label:>{wide}} ┤{row}" for label, row in zip(labels, rows, strict=True)]
    first, last = f"{x[0]:g}", f"{x[-1]:g}"
    axis = f"{'':{wide}} └{'─' * WIDTH}"
    below = f"{'':{wide}}  {first}{x_name:^{WIDTH - len(first) - len(last)}}{last}"
    scale = ", logarithmic" if is_log else ""
    return "\n".join([f"{y_name}{scale}", *lines, axis, below])


def sparkline(values: NDArray[np.float64]) -> str:
    """Draw values as a row of blocks, one each; a gap where one is not finite."""
    known = values[np.isfinite(values)]
    if not len(known):
        return ""
    low, span = float(known.min()), float(np.ptp(known)) or 1.0
    return "".join(
        "▁▂▃▄▅▆▇█"[round(7 * (value - low) / span)] if math.isfinite(value) else " " for value in values
    )


def _rows(values: NDArray[np.float64]) -> list[str]:
    """Return rows of dots, each dot of a column joined to its neighbour so that steep parts are whole."""
    span = float(np.ptp(values)) or 1.0
    level = np.rint((values.max() - values) / span * (4 * HEIGHT - 1)).astype(int)
    cells = np.zeros((HEIGHT, WIDTH), dtype=int)
    before = level[0]
    for column, here in enumerate(level):
        joined = range(here, before) if here < before else range(min(before + 1, here), here + 1)
        for row in joined:
            cells[row // 4, column // 2] |= _DOTS[row % 4][column % 2]
        before = here
    return ["".join(chr(_BLANK + cell) for cell in row).rstrip(chr(_BLANK)) for row in cells]
