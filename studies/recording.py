"""Import a published recording: the MATLAB file, the FMU that holds it, or CSV files; check it, write our CSV.

Only this module knows how recordings look outside the project.
"""

import csv
import io
import math
import os
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulation.errors import InputError

Array = NDArray[np.float64]

MATLAB_FILE = "identification_data.mat"
DAY_S = 86_400.0


@dataclass(frozen=True)
class Signal:
    """One recorded series.

    Args:
        variable: name in the published file.
        column: name in our CSV.
        step_s: sampling step. [s]
        lower: smallest value that makes sense.
        upper: largest value that makes sense.
        is_switch: on and off, written as an integer.
    """

    variable: str
    column: str
    step_s: int
    lower: float
    upper: float
    is_switch: bool = False


SIGNALS = (
    Signal("TRoom", "TRoom_degC", 1800, -10.0, 60.0),
    Signal("TEnv", "TEnv_degC", 1800, -60.0, 60.0),
    Signal("TSupply", "TSupply_degC", 1800, -10.0, 90.0),
    Signal("FlowSupply", "FlowSupply", 1800, 0.0, 1.0, is_switch=True),
    Signal("TRLTSupply", "TRLTSupply_degC", 1800, -30.0, 90.0),
    Signal("RLTFlow", "RLTFlow", 1800, 0.0, 1.0, is_switch=True),
    Signal("IrrGH", "IrrGH_W_m2", 1800, -10.0, 1500.0),
    Signal("Occupancy", "Occupancy", 600, 0.0, 1.0),
)
FILES = {1800: "recording_1800s.csv", 600: "occupancy_600s.csv"}
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
        """Length of the shortest grid. [d]"""
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
    series, source = _read(sources)
    recording, kelvin = _checked(series, source)
    folder.mkdir(parents=True, exist_ok=True)
    _write_atomically({folder / name: _as_csv(recording, step) for step, name in FILES.items()})
    files = [folder / name for name in FILES.values()]
    rows = tuple(len(recording.time_s[step]) for step in FILES)
    return ImportReport(source, tuple(files), rows, recording.duration_d, kelvin)


def _read(sources: list[Path]) -> tuple[dict[str, tuple[Array, Array]], str]:
    """Return (time, values) per variable, and what they came from."""
    for source in sources:
        if not source.exists():
            raise InputError(f"there is no file {source}")
    first = sources[0]
    if len(sources) == 1 and first.is_dir():
        files = [first / name for name in FILES.values()]
        for file in files:
            if not file.is_file():
                raise InputError(
                    f"the folder {first} has no {file.name}; it needs {' and '.join(FILES.values())}"
                )
        return _read_csv_files(files), str(first)
    suffix = first.suffix.lower()
    if suffix == ".csv":
        return _read_csv_files(sources), " and ".join(str(source) for source in sources)
    if len(sources) > 1:
        raise InputError(f"two files are read only where both are CSV; give {first} alone")
    if suffix == ".mat":
        return _read_matlab(first.read_bytes(), str(first)), str(first)
    if suffix == ".fmu":
        return _read_fmu(first)
    raise InputError(f"{first} is no .mat, .fmu, .csv and no folder with {' and '.join(FILES.values())}")


def _read_fmu(file: Path) -> tuple[dict[str, tuple[Array, Array]], str]:
    try:
        with zipfile.ZipFile(file) as archive:
            inside = [name for name in archive.namelist() if Path(name).name == MATLAB_FILE]
            if not inside:
                raise InputError(
                    f"{file} holds no {MATLAB_FILE}; this is not the authors' FMU with the recording"
                )
            content = archive.read(inside[0])
    except zipfile.BadZipFile:
        raise InputError(f"{file} is not a zip archive, so not an FMU; download it again") from None
    source = f"{file} ({inside[0]})"
    return _read_matlab(content, source), source


def _read_matlab(content: bytes, source: str) -> dict[str, tuple[Array, Array]]:
    from scipy.io import loadmat

    try:
        loaded: Mapping[str, Any] = loadmat(io.BytesIO(content))
    except Exception as error:
        # scipy raises many kinds of exception for bytes that are not what they claim to be
        raise InputError(
            f"{source} is not a readable MATLAB file ({type(error).__name__}: {error})"
        ) from None
    found = sorted(name for name in loaded if not name.startswith("__"))
    series = {}
    for signal in SIGNALS:
        if signal.variable not in loaded:
            raise InputError(
                f"{source} has no variable {signal.variable}; it has {', '.join(found) or 'none'}"
            )
        table = np.asarray(loaded[signal.variable])
        if table.dtype.kind not in "fiub" or table.ndim != 2 or 2 not in table.shape:
            raise InputError(
                f"{source}: {signal.variable} has shape {table.shape} and type {table.dtype}; "
                "expected two columns of numbers, time in s and value"
            )
        table = table.astype(np.float64)
        if table.shape[1] != 2:
            table = table.T
        series[signal.column] = (table[:, 0], table[:, 1])
    return series


def _read_csv_files(files: list[Path]) -> dict[str, tuple[Array, Array]]:
    series: dict[str, tuple[Array, Array]] = {}
    found: list[str] = []
    for file in files:
        columns = _read_csv(file)
        found += columns
        for name, values in columns.items():
            if name != "time_s":
                series[name] = (columns["time_s"], values)
    names = ", ".join(str(file) for file in files)
    for signal in SIGNALS:
        if signal.column not in series:
            raise InputError(
                f"{names}: no column {signal.column}; found {', '.join(found)}"
                + (
                    ""
                    if len(files) > 1
                    else f" (give both files, {' and '.join(FILES.values())}, or their folder)"
                )
            )
    return series


def _read_csv(file: Path) -> dict[str, Array]:
    try:
        with file.open(newline="", encoding="utf-8-sig") as stream:
            rows = [row for row in csv.reader(stream) if row]
    except (UnicodeDecodeError, csv.Error, OSError) as error:
        raise InputError(f"{file} is not a readable CSV file: {error}") from None
    if len(rows) < 2:
        raise InputError(f"{file} has no rows below its heading")
    heading = [name.strip() for name in rows[0]]
    if "time_s" not in heading:
        raise InputError(f"{file}: no column time_s; found {', '.join(heading)}")
    table = np.empty((len(rows) - 1, len(heading)))
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(heading):
            raise InputError(f"{file}, line {line}: {len(row)} values where the heading names {len(heading)}")
        for index, text in enumerate(row):
            try:
                table[line - 2, index] = float(text)
            except ValueError:
                raise InputError(f"{file}, line {line}, {heading[index]}: {text!r} is not a number") from None
    return {name: table[:, index] for index, name in enumerate(heading)}


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
    """Return the times counted from the first one; they must be an even grid of the step. [s]"""
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
    partial = {file: file.with_name(f".{file.name}.{os.getpid()}") for file in texts}
    for file, text in texts.items():
        partial[file].write_text(text, encoding="utf-8")
    for file in texts:
        partial[file].replace(file)
