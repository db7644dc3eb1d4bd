"""What killed processes left half written: scratch files and folders with nobody behind them."""

import os
import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil

from studies.paths import ProjectPaths

QUIET_S = 3600.0
"""Scratch that names no process belongs to nobody after so long without a change."""

_NAMES = (
    re.compile(r"\.t\d+-(?P<pid>\d+)"),  # a trial being written
    re.compile(r"\.[\w.-]+-old-(?P<pid>\d+)"),  # a folder being replaced
    re.compile(r"\.weights-\w+"),
    re.compile(r"\.[\w.-]+-new"),
    re.compile(r"\..+\.[0-9a-f]{8}\.tmp"),  # a file being written whole
    re.compile(r"\.part-.+\.tmp"),
    re.compile(r"\.gone-.+"),
)


@dataclass(frozen=True)
class Scratch:
    """A leftover.

    Args:
        path: file or folder.
        size: of all that is in it. [byte]
        changed_s: its last change. [s since 1970, UTC]
    """

    path: Path
    size: int
    changed_s: float


def leftovers(paths: ProjectPaths, *, quiet_s: float = QUIET_S) -> Iterator[Scratch]:
    """Find what is half written and belongs to no living process.

    A folder that was being replaced, and whose new one never came, is no leftover: it is put back.

    Args:
        paths: the project.
        quiet_s: how long scratch that names no process must have been left alone. [s]
    """
    for top in (paths.mlruns, *paths.data.glob("*/generated")):
        for place in _hidden(top):
            match = next((m for pattern in _NAMES if (m := pattern.fullmatch(place.name))), None)
            if match is None or _is_last_copy(place):
                continue
            try:
                changed_s = place.stat().st_mtime
                size = size_of(place)
            except OSError:  # it is going at this moment
                continue
            pid = match.groupdict().get("pid")
            is_over = not psutil.pid_exists(int(pid)) if pid else False
            if is_over or place.name.startswith(".gone-") or time.time() - changed_s > quiet_s:
                yield Scratch(place, size, changed_s)


def size_of(place: Path) -> int:
    """Return the size of a file, or of all files in a folder. [byte]."""
    if not place.is_dir():
        return place.lstat().st_size
    total = 0
    for folder, _, files in os.walk(place):
        for name in files:
            try:
                total += (Path(folder) / name).lstat().st_size
            except OSError:
                continue
    return total


def _hidden(top: Path) -> Iterator[Path]:
    for folder, folders, files in os.walk(top):
        here = Path(folder)
        yield from (here / name for name in (*folders, *files) if name.startswith("."))
        folders[:] = [name for name in folders if not name.startswith(".") and name != "artifacts"]


def _is_last_copy(place: Path) -> bool:
    match = re.fullmatch(r"\.([\w.-]+)-old-\d+", place.name)
    return match is not None and not place.with_name(match[1]).exists()
