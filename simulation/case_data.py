"""The recordings of a case on one time axis: what is measured when, and what drives the model when."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.case_file import CaseFile, InputTable, OutputTable
from simulation.errors import InputError
from simulation.recording import Recording, read_recording
from simulation.scenario import covers
from simulation.sheets import real_path
from simulation.time_unit import HOURS
from simulation.timestamps import FIRST, zero_of, zone_named
from simulation.units import in_si
from simulation.write_gate import follows_links

# Samples further apart than this many usual steps have a gap between them.
GAP_STEPS = 1.5
FROM_FIRST_ROW = f'zero = "{FIRST}" in [time] counts from the first row instead'
_CLOCKS = {
    "seconds": "counts seconds",
    "local": "has timestamps without an offset from UTC",
    "utc": "has timestamps with an offset from UTC",
}


@dataclass(frozen=True, eq=False)
class CaseData:
    """All recordings of a case, with times on one axis.

    Attributes:
        recordings: By their names in the case file; their times are the model's.
        counts_seconds: Whether the times are those of the files, which count seconds from a zero of theirs.
    """

    recordings: dict[str, Recording]
    counts_seconds: bool

    def first_measured(self, table: OutputTable, start_s: float) -> float:
        """Return the measured value of an output at the start of the simulation: the nearest in time.

        Raises:
            InputError: If the nearest is further away than samples usually are, or samples are means.
        """
        if table.source is None:
            raise InputError(f"{table.name} is not measured; give a number")
        if table.mean_over_s is not None:
            raise InputError(
                f"{table.name} is measured as means over {table.mean_over_s:g} s, which say nothing of the "
                "start; give a number"
            )
        if table.starts_at is not None:
            raise InputError(f"{table.name} is measured by a counter that had run before; give a number")
        file, column = table.source
        recording = self.recordings[file]
        known = np.flatnonzero(~np.isnan(recording.columns[column]))
        if len(known):
            row = known[np.argmin(np.abs(recording.time[known] - start_s))]
            if abs(recording.time[row] - start_s) <= recording.step_s * (1.0 + 1e-6):
                return float(recording.columns[column][row])
        raise InputError(
            f"{recording.path} has no value of {column} near the start, {start_s:.12g} s; "
            "give a number, or choose a start_d (start_s) with a measured value"
        )

    def input_series(
        self, table: InputTable, column: str, edges: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the samples of a column that drives an input, checked to have no gap where it is needed.

        Args:
            table: The input.
            column: The column.
            edges: Edges of the communication steps. Shape (s + 1,). [s]

        Returns:
            Times [s] and values. Shape (m,) each.

        Raises:
            InputError: If the series does not cover the steps, or has a gap in them.
        """
        recording = self.recordings[table.file]
        known = ~np.isnan(recording.columns[column])
        # A mean is good from the begin of its interval on.
        time, values = recording.time[known] + table.interval[0], recording.columns[column][known]
        if table.mean_over_s is not None and abs(recording.step_s / table.mean_over_s - 1.0) > 1e-3:
            raise InputError(
                f"{recording.path} has a value every {recording.step_s:.12g} s, and each is said to go over "
                f"{table.mean_over_s:g} s; means of an input have to follow each other"
            )
        if len(time) < 2 or not covers(time, edges, table.course):
            held = f"covers {time[0]:.12g} to {time[-1]:.12g} s" if len(time) else "is empty"
            remedy = "choose another window, or record longer"
            if len(time) and (time[0] > edges[-1] or time[-1] < edges[0]):
                remedy = "no moment is in both; correct the times of this file or of the first output's"
            elif len(time) and time[0] > edges[0]:
                remedy = "begin the simulation later, or record from its begin on"
                remedy += f"; {FROM_FIRST_ROW}" * self.counts_seconds
            needs = f"the simulation needs {edges[0]:.12g} to {edges[-1]:.12g} s"
            raise InputError(f"{recording.path} {held}, {needs}; {remedy}")
        longest = GAP_STEPS * recording.step_s if table.max_gap_s is None else table.max_gap_s
        # A held value is needed until the window ends, the others as far as the next sample.
        is_held = table.course in ("held", "spread")
        ends = np.minimum(time[1:], edges[-1]) if is_held else time[1:]
        steps = ends - time[:-1]
        is_needed = (time[:-1] < edges[-1]) & (time[1:] > edges[0])
        for row in np.flatnonzero(is_needed & (steps > longest * (1.0 + 1e-9)))[:1]:
            # The line after the last value: its cell is empty, or its time is too late.
            before, after = np.flatnonzero(known)[[row, row + 1]].tolist()
            line = before + 1 + recording.first_line
            gap = f"{time[row]:.12g} to {time[row + 1]:.12g} s"
            if recording.clock != "seconds" and recording.stamps:
                gap = f"{recording.stamps[before]} to {recording.stamps[after]} ({steps[row]:.12g} s)"
            raise InputError(
                f"{recording.path}: line {line}: {column} has no value from {gap}; "
                f"fill the gap, or write max_gap_s = {steps[row]:.12g} for "
                f"inputs[{table.name}], which interpolates{_clock_hint(recording, float(steps[row]))}"
            )
        return time, values


def _clock_hint(recording: Recording, gap_s: float) -> str:
    """Return the advice for a gap of one hour: clocks may have been set forward."""
    hour_s = HOURS.seconds
    if recording.clock == "seconds" or abs(gap_s - recording.step_s - hour_s) > 1e-6 * hour_s:
        return ""
    if recording.clock == "local":
        return "; if it is the change to summer time, write the timezone into the case instead"
    return "; if this clock has no summer time, remove timezone from the case instead"


def read_recordings(path: Path, file: CaseFile) -> dict[str, Recording]:
    """Read every recording that a case names, each once, with the columns in use.

    Args:
        path: The case file.
        file: Its content.

    Returns:
        The recordings by their names in the case file.

    Raises:
        InputError: If one cannot be read.
    """
    folder = path.parent / file.data
    measured = [column for output in file.outputs for column in output.columns]
    own = Path(os.path.realpath(path)).parent
    # A project has its cases in fmus/ and their recordings beside that.
    own = own.parents[1] if own.parent.name == "fmus" else own
    return read_columns(
        file,
        measured,
        lambda name: real_path(folder / name),
        file.data_origin,
        lambda place: place.is_relative_to(own) or follows_links(),
    )


def read_columns(
    file: CaseFile,
    measured: list[tuple[str, str]],
    place_of: Callable[[str], Path],
    if_missing: str = "",
    is_quoted: Callable[[Path], bool] = lambda place: True,
) -> dict[str, Recording]:
    """Read the recordings of a case's inputs and others, as it says how their times are written.

    Args:
        file: The case file's content.
        measured: Recording and column of what else is read, by their names in the case file.
        place_of: Where a recording of some name lies.
        if_missing: What to do where there is no such file; "" for the general advice.
        is_quoted: Whether messages may quote what a file holds: a case may name any file of the user.

    Raises:
        InputError: If one cannot be read.
    """
    columns: dict[str, list[str]] = {}
    for name, column in measured:
        columns.setdefault(name, []).append(column)
    for source in file.inputs:
        columns.setdefault(source.file, []).extend(source.weights)
    return {
        name: read_recording(
            place_of(name),
            list(dict.fromkeys(wanted)),
            time_column=file.time_column,
            timezone=file.timezone,
            stamps=file.stamps,
            decimal=file.decimal,
            if_missing=if_missing,
            is_quoted=is_quoted(place_of(name)),
        )
        for name, wanted in columns.items()
    }


def _check_units(file: CaseFile, recordings: dict[str, Recording]) -> None:
    """Check that lines of units in the recordings say what the case says."""
    tables = [(f"inputs[{one.name}]", one.file, one.column, one.unit) for one in file.inputs]
    tables += [(f"outputs[{one.name}]", one.file or "", one.column, one.unit) for one in file.outputs]
    for where, name, column, unit in tables:
        # A sum of columns has a unit of its own.
        said = recordings[name].units.get(column) if column and name in recordings else None
        if said is not None and in_si(said) != in_si(unit):
            raise InputError(
                f'{where}: unit = "{unit}", but line {recordings[name].first_line - 1} of '
                f'{recordings[name].path} says "{said}" of column {column}; correct one of the two'
            )


def on_one_axis(file: CaseFile, recordings: dict[str, Recording], leading: str = "") -> CaseData:
    """Put recordings on one time axis.

    Args:
        file: The case file's content.
        recordings: The recordings by their names in it.
        leading: Name of the one whose first row may be time 0; "" for the first output's.

    Raises:
        InputError: If their times do not belong together, or their units are not the case's.
    """
    used = list(dict.fromkeys(recording.time_column for recording in recordings.values()))
    if file.time_column is not None and file.time_column not in used:
        raise InputError(
            f'time_column = "{file.time_column}" is in none of {", ".join(recordings)}, whose times '
            f"stand in {', '.join(used)}; correct it, or drop the key"
        )
    _check_units(file, recordings)
    first = recordings[leading or next(one.file for one in file.outputs if one.file is not None)]
    for recording in recordings.values():
        if recording.clock != first.clock:
            raise InputError(
                f"{recording.path} {_CLOCKS[recording.clock]} and {first.path} {_CLOCKS[first.clock]}; "
                "write the times of all files alike"
            )
    counts_seconds = first.clock == "seconds" and file.time.zero is None
    zero_s = 0.0 if counts_seconds else float(first.time[0])
    if file.time.zero not in (None, FIRST):
        zero_s = zero_of(file.time.zero, first.clock, zone_named(file.timezone), file.stamps)
    return CaseData({name: one.since(zero_s) for name, one in recordings.items()}, counts_seconds)
