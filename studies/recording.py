"""Import a published recording: check it and write it as the CSV files of the recorded case."""

import math
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulation.errors import InputError
from simulation.whole_file import whole_file
from studies.recording_files import FILES, SIGNALS, Array, read_series

DAY_S = 86_400.0


MIN_DURATION_D = 10.0
"""Shorter than this, not even the calibration window of the paper fits."""


@dataclass(frozen=True)
class Recording:
    """A checked recording.

    Args:
        time_s: per step, the grid from 0 on. Shape (m,). [s]
        values: per column of our CSV, the series. Shape (m,).
        source: where it came from.
    """

    time_s: Mapping[int, Array]
    values: Mapping[str, Array]
    source: str

    @property
    def duration_d(self) -> float:
        """Length of the shortest grid. [d]."""
        return min(float(time[-1]) for time in self.time_s.values()) / DAY_S


@dataclass(frozen=True)
class ImportReport:
    """What an import did.

    Args:
        source: what was read.
        files: what was written.
        n_rows: rows per file.
        duration_d: length. [d]
        kelvin: columns converted from kelvin.
    """

    source: str
    files: tuple[Path, ...]
    n_rows: tuple[int, ...]
    duration_d: float
    kelvin: tuple[str, ...]


def import_recording(sources: list[Path], folder: Path) -> ImportReport:
    """Read a recording, check it, and write it as the two CSV files of the recorded case.

    Args:
        sources: one `.mat`, `.fmu` or folder, or the two CSV files.
        folder: where the CSV files go; created if missing, replaced only when everything was good.

    Raises:
        InputError: not readable, a variable missing, an uneven grid, NaN, a value out of range, too short.
    """
    series, source = read_series(sources)
    recording, kelvin = _checked(series, source)
    folder.mkdir(parents=True, exist_ok=True)
    _write_atomically({folder / name: _as_csv(recording, step) for step, name in FILES.items()})
    files = [folder / name for name in FILES.values()]
    rows = tuple(len(recording.time_s[step]) for step in FILES)
    return ImportReport(source, tuple(files), rows, recording.duration_d, kelvin)


def _checked(series: Mapping[str, tuple[Array, Array]], source: str) -> tuple[Recording, tuple[str, ...]]:
    times: dict[int, Array] = {}
    values: dict[str, Array] = {}
    kelvin = []
    for signal in SIGNALS:
        time, value = series[signal.column]
        where = f"{source}: {signal.column}"
        grid = _checked_grid(time, signal.step_s, where)
        if signal.step_s in times and len(times[signal.step_s]) != len(grid):
            raise InputError(
                f"{where} has {len(grid)} rows, the columns before it {len(times[signal.step_s])}"
            )
        if abs(time[0] - series[SIGNALS[0].column][0][0]) > 1e-3:
            raise InputError(f"{where} begins at {time[0]:g} s, {SIGNALS[0].column} at another time")
        times[signal.step_s] = grid
        bad = np.flatnonzero(~np.isfinite(value))
        if bad.size:
            raise InputError(f"{where} is {value[bad[0]]} at {grid[bad[0]]:.0f} s; fill or cut the gap")
        if signal.column.endswith("_degC") and float(np.min(value)) > 150.0:
            value = value - 273.15
            kelvin.append(signal.column)
        outside = np.flatnonzero((value < signal.lower - 1e-9) | (value > signal.upper + 1e-9))
        if outside.size:
            raise InputError(
                f"{where} is {value[outside[0]]:g} at {grid[outside[0]]:.0f} s, "
                f"outside {signal.lower:g} to {signal.upper:g}; check the unit"
            )
        values[signal.column] = value
    recording = Recording(times, values, source)
    if recording.duration_d < MIN_DURATION_D - 0.5:
        raise InputError(
            f"{source} covers {recording.duration_d:.2f} days; at least {MIN_DURATION_D:g} days are needed"
        )
    return recording, tuple(kelvin)


def _checked_grid(time: Array, step_s: int, where: str) -> Array:
    """Return the times counted from the first one; they must be an even grid of the step. [s]."""
    if time.size < 2 or not np.isfinite(time).all():
        raise InputError(f"{where}: fewer than two times, or a time that is no number")
    uneven = np.flatnonzero(~np.isclose(np.diff(time), step_s, rtol=0.0, atol=1e-3))
    if uneven.size:
        at = int(uneven[0])
        raise InputError(
            f"{where}: after {time[at]:.0f} s comes {time[at + 1]:.0f} s; expected even steps of {step_s} s"
        )
    return step_s * np.arange(time.size, dtype=np.float64)


def _as_csv(recording: Recording, step_s: int) -> str:
    signals = [signal for signal in SIGNALS if signal.step_s == step_s]
    lines = [",".join(["time_s", *(signal.column for signal in signals)])]
    for row, time in enumerate(recording.time_s[step_s]):
        cells = [_cell(recording.values[signal.column][row], signal.is_switch) for signal in signals]
        lines.append(",".join([f"{time:.0f}", *cells]))
    return "\n".join(lines) + "\n"


def _cell(value: float, is_switch: bool) -> str:
    if is_switch and math.isclose(value, round(value), abs_tol=1e-9):
        return str(round(value))
    text = f"{value:.6f}"
    return text[1:] if text == "-0.000000" else text


def _write_atomically(texts: Mapping[Path, str]) -> None:
    """Write all the files or none: each beside its place first, then all put in place."""
    with ExitStack() as begun:
        for file, text in texts.items():
            begun.enter_context(whole_file(file)).write(text.encode())
