"""Files that an FMU reads because a text of it names them: what they hold decides what it answers."""

import hashlib
import os
import re
import stat
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

from simulation.fmi.description import FmuDescription
from simulation.fmi.variable import Value
from simulation.foreign_file import UNPACKED
from simulation.foreign_text import has_control

MOST_FILES = 10_000
"""Files of a folder that is named; more are not read."""
# $HOME, ${HOME}, %HOME% and ~, which another program would replace.
_REPLACED = re.compile(r"^~|\$\{?\w|%\w+%")
# What a text has that is meant as a path: separators, or a name with an ending.
_LIKE_A_PATH = re.compile(r"[/\\]|^\S+\.[A-Za-z]\w{0,4}$")


@dataclass(frozen=True)
class NamedFiles:
    """What the texts of an FMU name.

    Attributes:
        digests: SHA-256 of the content of each file, by the parameter that names it and the file's place
            below what it names.
        files: The files.
        unknown: Parameters whose text looks like a path that cannot be followed, with why.
    """

    digests: Mapping[str, str]
    files: tuple[Path, ...]
    unknown: Mapping[str, str]


def named_files(fmu: FmuDescription, fixed: Mapping[str, Value]) -> NamedFiles:
    """Find the files that text parameters of an FMU name, and read what they hold.

    A text that names a folder stands for all files below it. Files inside the FMU belong to it anyway.

    Args:
        fmu: What the FMU says of itself; the start value of a text counts where the case gives none.
        fixed: Parameters that the case holds at a value.
    """
    digests, files, unknown = dict[str, str](), list[Path](), dict[str, str]()
    for name, variable in sorted(fmu.variables.items()):
        if variable.kind != "String" or variable.causality not in ("parameter", "input"):
            continue
        text = fixed.get(name, variable.start_text)
        if not isinstance(text, str) or not text or has_control(text):
            continue
        place = _place(text)
        if _REPLACED.search(text):
            unknown[name] = "names a variable of the environment or a home folder"
        elif not place.is_absolute():
            if _LIKE_A_PATH.search(text) and not text.startswith("modelica:"):
                unknown[name] = "is a relative path, and an FMU may count it from anywhere"
        elif (found := _found(place)) is None:
            unknown[name] = "names what cannot be read, or too much of it"
        else:
            for file in found:
                below = "" if file == place else file.relative_to(place).as_posix()
                digests[f"{name}:{below}"] = _digest(file)
                files.append(file)
    return NamedFiles(digests, tuple(files), unknown)


def _place(text: str) -> Path:
    """Return the path that a text means, which may be written as an address."""
    return Path(unquote(urlsplit(text).path) if text.lower().startswith("file:") else text)


def _found(place: Path) -> list[Path] | None:
    """Return the file of this place, or all files below; none where nothing is there, None for too much."""
    try:
        mode = place.stat().st_mode
        if stat.S_ISREG(mode):
            files = [place]
        elif stat.S_ISDIR(mode):
            files = []
            for file in _below(place):
                files.append(file)
                if len(files) > MOST_FILES:
                    return None
        else:
            return None
        n_bytes = sum(file.stat().st_size for file in files)
        readable = all(os.access(file, os.R_OK) for file in files)
    except FileNotFoundError:
        return []
    except OSError:
        return None
    return sorted(files) if readable and n_bytes <= UNPACKED.most * 1_000_000 else None


def _below(folder: Path) -> Iterator[Path]:
    for where, _, names in os.walk(folder):
        for name in names:
            file = Path(where) / name
            # A pipe would wait for a writer.
            if stat.S_ISREG(file.stat().st_mode):
                yield file


# By place, size and time of change: a case is loaded several times in a process, and tables may be large.
_known: dict[tuple[object, ...], str] = {}


def _digest(file: Path) -> str:
    status = file.stat()
    key = file, status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
    if key not in _known:
        with file.open("rb") as stream:
            _known[key] = hashlib.file_digest(stream, "sha256").hexdigest()
    return _known[key]
