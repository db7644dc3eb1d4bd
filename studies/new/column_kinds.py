"""What CSV files that are there say of a new case: which inputs are switches, how far outputs scatter."""

from pathlib import Path

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.recording import read_recording
from studies.new.text import INPUTS_FILE, MEASURED_FILE, NewCase

_LEAST = 8
"""Values of a column from which its scatter is taken."""
_OF_MEDIAN = 1.4826
"""Standard deviation of normal numbers, in medians of their sizes."""


def switches_of(case: NewCase, data: Path) -> frozenset[str]:
    """Return the inputs whose column has two values.

    Args:
        case: The case.
        data: The folder of its recordings.
    """
    columns = {one.name: _column(data / INPUTS_FILE, one.name) for one in case.inputs}
    return frozenset(name for name, values in columns.items() if len(np.unique(values)) == 2)


def noise_of(case: NewCase, data: Path) -> dict[str, float]:
    """Return how far outputs scatter around the line between their neighbours. [unit of the column].

    Args:
        case: The case.
        data: The folder of its recordings.
    """
    found = {}
    for one in case.outputs.used:
        values = _column(data / MEASURED_FILE, one.name)
        if len(values) >= _LEAST:
            # Of independent errors this has six times their variance.
            scatter = float(np.median(np.abs(np.diff(values, 2)))) * _OF_MEDIAN / np.sqrt(6.0)
            if scatter > 0.0:
                found[one.name] = float(f"{scatter:.2g}")
    return found


def _column(file: Path, name: str) -> FloatArray:
    """Return the values of a column, none where it cannot be read: `studies check` says why."""
    if not file.is_file():
        return np.empty(0)
    try:
        values = read_recording(file, [name]).columns[name]
    except InputError:
        return np.empty(0)
    return values[~np.isnan(values)]
