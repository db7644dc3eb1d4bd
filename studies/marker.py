"""The file `studies.toml`, which makes a folder a project."""

import os
from pathlib import Path

from simulation.errors import InputError, MachineError
from simulation.whole_file import whole_file
from studies.console import Console

MARKER = "studies.toml"
ROOT_VARIABLE = "STUDIES_ROOT"
TEXT = "# This folder is a project of `studies`: results go to mlruns/ and data/, own cases to fmus/.\n"


def find_root() -> Path:
    """Find the project's folder: the nearest one with a marker, from the working folder upwards.

    Where there is none, it is the working folder. `$STUDIES_ROOT` names another folder to begin at.

    Raises:
        InputError: `$STUDIES_ROOT` is set and is no folder.
    """
    declared = os.environ.get(ROOT_VARIABLE)
    begin = Path(declared).expanduser() if declared else Path.cwd()
    if not begin.is_dir():
        raise InputError(f"${ROOT_VARIABLE} is {declared!r}, which is not a folder; correct or unset it")
    begin = begin.resolve()
    for folder in (begin, *begin.parents):
        if (folder / MARKER).is_file():
            return folder
    return begin


def mark_project(root: Path, console: Console) -> None:
    """Make a folder a project and name it; a project stays as it is.

    Raises:
        MachineError: the folder cannot be written.
    """
    file = root / MARKER
    if file.is_file():
        return
    try:
        with whole_file(file) as stream:
            stream.write(TEXT.encode())
    except OSError as error:
        raise MachineError(
            f"{root}: the project's folder cannot be written ({error.strerror}); go to another folder"
        ) from None
    console.say(f"project: {root} ({MARKER} made)")
