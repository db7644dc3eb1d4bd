"""The file that `studies best --write` leaves: its formats, its name, and that nothing is overwritten."""

import errno
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

from simulation.errors import InputError
from simulation.foreign_text import quoted
from simulation.whole_file import whole_file
from studies.exports.calibrated_values import CalibratedValues, calibrated_values
from studies.exports.start_values import as_fmu
from studies.exports.surrogate_graph import as_onnx
from studies.exports.value_texts import as_csv, as_json, as_modelica, as_ssv
from studies.paths import folder_name
from studies.project import Project

OF_VALUES: Final[dict[str, tuple[str, Callable[[CalibratedValues], bytes]]]] = {
    "ssv": ("ssv", as_ssv),
    "modelica": ("mo", as_modelica),
    "csv": ("csv", as_csv),
    "json": ("json", as_json),
    "fmu": ("fmu", as_fmu),
}
"""Ending of the file's name, and what it holds."""
FORMATS: Final = (*OF_VALUES, "onnx")


def write_best(
    project: Project, words: Sequence[str], n_train: int | None, experiment: str | None = None
) -> Path:
    """Write the best calibration, or the best surrogate, to a new file.

    Args:
        project: What the project holds of a case.
        words: The format and, if it is said, the file; otherwise the case names it, in the working folder.
        n_train: Training-set size of the surrogate; None for all.
        experiment: Which experiment's values; None where the case has none.

    Returns:
        The file.

    Raises:
        InputError: The format is unknown, the file exists, or there is nothing that can be written.
    """
    kind, *files = words
    if kind not in FORMATS or len(files) > 1:
        raise InputError(
            f"--write {quoted(' '.join(words))}: give one of {', '.join(FORMATS)}, then at most one file"
        )
    # Before the work, which may take seconds.
    if files:
        _refuse_existing(Path(files[0]))
    if kind == "onnx":
        name, content = as_onnx(project, n_train)
        ending = kind
    else:
        found = calibrated_values(project, experiment)
        ending, written = OF_VALUES[kind]
        name, content = f"{found.case.name}-calibrated", written(found)
    file = Path(files[0]) if files else Path(f"{folder_name(name)}.{ending}")
    _refuse_existing(file)
    try:
        with whole_file(file) as stream:
            stream.write(content)
    except OSError as error:
        if error.errno == errno.ENOSPC:  # a fault of the machine
            raise
        raise InputError(f"{file}: cannot be written ({error.strerror}); name another file") from None
    return file


def _refuse_existing(file: Path) -> None:
    if os.path.lexists(file):
        raise InputError(f"{file} exists; name another file after the format, or remove it")
