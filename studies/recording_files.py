"""How recordings look outside the project: MATLAB files, the FMU that holds one, CSV files."""

import csv
import io
import math
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from simulation.errors import InputError
from simulation.foreign_file import FMU, RECORDING, UNPACKED, check_members, read_limited, read_text
from simulation.foreign_text import quoted, shortened

Array = NDArray[np.float64]

MATLAB_FILE = "identification_data.mat"


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


def read_series(sources: list[Path]) -> tuple[dict[str, tuple[Array, Array]], str]:
    """Return (time, values) per column of our CSV, and what they came from.

    Args:
        sources: one `.mat`, `.fmu` or folder, or the two CSV files.

    Raises:
        InputError: a file is missing, not readable, or lacks a variable.
    """
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
        return _read_matlab(read_limited(first, RECORDING), str(first)), str(first)
    if suffix == ".fmu":
        return _read_fmu(first)
    raise InputError(f"{first} is no .mat, .fmu, .csv and no folder with {' and '.join(FILES.values())}")


def _read_fmu(file: Path) -> tuple[dict[str, tuple[Array, Array]], str]:
    try:
        with zipfile.ZipFile(io.BytesIO(read_limited(file, FMU))) as archive:
            check_members(archive.infolist(), str(file))
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
    from scipy.io import loadmat, whosmat

    try:
        # Its arrays are compressed, and may be a thousand times as large as the file.
        shapes = [shape for _, shape, _ in whosmat(cast("str", io.BytesIO(content)))]
        UNPACKED.check(sum(8e-6 * math.prod(shape) for shape in shapes), source)
        loaded: Mapping[str, Any] = loadmat(cast("str", io.BytesIO(content)))
    except InputError:
        raise
    except Exception as error:
        # scipy raises many kinds of exception for bytes that are not what they claim to be
        raise InputError(
            f"{source} is not a readable MATLAB file ({type(error).__name__}: {shortened(str(error))})"
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
        rows = [row for row in csv.reader(io.StringIO(read_text(file, RECORDING), newline="")) if row]
    except csv.Error as error:
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
                raise InputError(
                    f"{file}, line {line}, {heading[index]}: {quoted(text)} is not a number"
                ) from None
    return {name: table[:, index] for index, name in enumerate(heading)}
