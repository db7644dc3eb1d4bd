"""Import the paper's recording: read it as published, check it, write the recorded case's CSV files."""

import io
import math
import zipfile
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.foreign_file import FMU, RECORDING, UNPACKED, archive_errors, check_members, read_limited
from simulation.foreign_text import shortened
from simulation.recording import read_recording
from simulation.whole_file import whole_file

DAY_S = 86_400.0
MIN_DURATION_D = 9.5
"""Shorter than this, not even the calibration window of the paper fits."""
MATLAB_FILE = "identification_data.mat"
WHOLE = ("time_s", "FlowSupply", "RLTFlow")
"""Columns of whole numbers, where that is exact: times and switches."""
FILES = {1800: "recording_1800s.csv", 600: "occupancy_600s.csv"}
"""Our CSV files by the sampling step of their columns. [s]"""


@dataclass(frozen=True)
class Signal:
    """One recorded series.

    Args:
        variable: name in the published file.
        column: name in our CSV.
        lower: smallest value that makes sense.
        upper: largest value that makes sense.
        step_s: sampling step. [s]
    """

    variable: str
    column: str
    lower: float
    upper: float
    step_s: int = 1800


SIGNALS = (
    Signal("TRoom", "TRoom_degC", -10.0, 60.0),
    Signal("TEnv", "TEnv_degC", -60.0, 60.0),
    Signal("TSupply", "TSupply_degC", -10.0, 90.0),
    Signal("FlowSupply", "FlowSupply", 0.0, 1.0),
    Signal("TRLTSupply", "TRLTSupply_degC", -30.0, 90.0),
    Signal("RLTFlow", "RLTFlow", 0.0, 1.0),
    Signal("IrrGH", "IrrGH_W_m2", -10.0, 1500.0),
    Signal("Occupancy", "Occupancy", 0.0, 1.0, step_s=600),
)
Series = Mapping[str, tuple[FloatArray, FloatArray]]
"""Times and values by column. Shape (m,) each. [s], [per column]"""


@dataclass(frozen=True)
class ImportReport:
    """What an import did.

    Args:
        source: what was read.
        files: what was written.
        n_rows: rows per file.
        duration_d: length. [d]
    """

    source: str
    files: tuple[Path, ...]
    n_rows: tuple[int, ...]
    duration_d: float


def import_recording(source: Path, folder: Path) -> ImportReport:
    """Read a recording, check it, and write it as the two CSV files of the recorded case.

    Args:
        source: a `.mat`, the `.fmu` that holds it, or a folder with the two CSV files.
        folder: where the CSV files go; created if missing, replaced only when everything was good.

    Raises:
        InputError: not readable, a variable missing, an uneven grid, NaN, a value out of range, too short.
    """
    series, name = _read(source)
    tables = {}
    for step_s, file in FILES.items():
        signals = [signal for signal in SIGNALS if signal.step_s == step_s]
        begin, n = series[SIGNALS[0].column][0][0], len(series[signals[0].column][0])
        columns = {"time_s": step_s * np.arange(n, dtype=np.float64)}
        for one in signals:
            time, values = series[one.column]
            columns[one.column] = _checked(f"{name}: {one.column}", one, time - begin, values, n)
        tables[folder / file] = columns
    duration_d = min(float(columns["time_s"][-1]) for columns in tables.values()) / DAY_S
    if duration_d < MIN_DURATION_D:
        raise InputError(f"{name} covers {duration_d:.2f} days; at least 10 days are needed")
    with ExitStack() as begun:  # all files or none
        for place, columns in tables.items():
            _write(begun.enter_context(whole_file(place)), columns)
    n_rows = tuple(len(columns["time_s"]) for columns in tables.values())
    return ImportReport(name, tuple(tables), n_rows, duration_d)


def _read(source: Path) -> tuple[Series, str]:
    if not source.exists():
        raise InputError(f"there is no file {source}")
    if source.is_dir():
        series: dict[str, tuple[FloatArray, FloatArray]] = {}
        for step_s, file in FILES.items():
            names = [signal.column for signal in SIGNALS if signal.step_s == step_s]
            found = read_recording(source / file, names)
            series |= {name: (found.time, found.columns[name]) for name in names}
        return series, str(source)
    if not zipfile.is_zipfile(source):
        return _read_matlab(read_limited(source, RECORDING), str(source)), str(source)
    with archive_errors(source), zipfile.ZipFile(io.BytesIO(read_limited(source, FMU))) as archive:
        check_members(archive.infolist(), str(source))
        inside = [name for name in archive.namelist() if Path(name).name == MATLAB_FILE]
        if not inside:
            raise InputError(
                f"{source} holds no {MATLAB_FILE}; this is not the authors' FMU with the recording"
            )
        name = f"{source} ({inside[0]})"
        return _read_matlab(archive.read(inside[0]), name), name


def _read_matlab(content: bytes, source: str) -> Series:
    from scipy.io import loadmat, whosmat

    try:
        # Its arrays are compressed, and may be a thousand times as large as the file.
        shapes = [shape for _, shape, _ in whosmat(cast("str", io.BytesIO(content)))]
        UNPACKED.check(sum(8e-6 * math.prod(shape) for shape in shapes), source)
        loaded: Mapping[str, Any] = loadmat(cast("str", io.BytesIO(content)))
    except InputError:
        raise
    except Exception as error:
        # scipy raises many kinds of exception for bytes that are no MATLAB file
        raise InputError(
            f"{source} is no MATLAB file, no FMU and no folder with {' and '.join(FILES.values())} "
            f"({type(error).__name__}: {shortened(str(error))})"
        ) from None
    series = {}
    for signal in SIGNALS:
        if signal.variable not in loaded:
            found = ", ".join(sorted(name for name in loaded if not name.startswith("__"))) or "none"
            raise InputError(f"{source} has no variable {signal.variable}; it has {found}")
        table = np.asarray(loaded[signal.variable])
        if table.dtype.kind not in "fiub" or table.ndim != 2 or 2 not in table.shape:
            raise InputError(
                f"{source}: {signal.variable} has shape {table.shape} and type {table.dtype}; "
                "expected two columns of numbers, time in s and value"
            )
        columns = table.T if table.shape[1] == 2 else table
        series[signal.column] = (columns[0].astype(np.float64), columns[1].astype(np.float64))
    return series


def _checked(where: str, signal: Signal, time: FloatArray, values: FloatArray, n: int) -> FloatArray:
    """Return the values of a series; its times, from the begin of the recording on, are an even grid."""
    uneven = np.flatnonzero(~(np.abs(time - signal.step_s * np.arange(len(time))) <= 1e-3))
    if uneven.size:
        at = int(uneven[0])
        raise InputError(
            f"{where}: row {at} has the time {time[at]:.0f} s after the begin; expected even steps of "
            f"{signal.step_s} s, so {at * signal.step_s} s"
        )
    if len(time) != n:
        raise InputError(f"{where} has {len(time)} rows, the columns before it {n}")
    for row in np.flatnonzero(~np.isfinite(values))[:1]:
        raise InputError(f"{where} is {values[row]} at {time[row]:.0f} s; fill or cut the gap")
    for row in np.flatnonzero((values < signal.lower - 1e-9) | (values > signal.upper + 1e-9))[:1]:
        raise InputError(
            f"{where} is {values[row]:g} at {time[row]:.0f} s, outside {signal.lower:g} to "
            f"{signal.upper:g}; check the unit"
        )
    return values


def _write(stream: BinaryIO, columns: Mapping[str, FloatArray]) -> None:
    forms = [
        "%.0f" if name in WHOLE and np.allclose(values, np.rint(values), rtol=0.0, atol=1e-9) else "%.6f"
        for name, values in columns.items()
    ]
    # Zeros have no sign.
    table = np.round(np.column_stack([*columns.values()]), 6) + 0.0
    np.savetxt(stream, table, forms, ",", header=",".join(columns), comments="")
