"""The folder of a store: parts that appear whole, under names of their own, and go only when merged.

A part is written under a name that nobody reads, then renamed: a process killed at any point, or a full
disk, leaves whole parts and at most a leftover, which goes when the folder is opened and nobody writes.
"""

import contextlib
import hashlib
import json
import os
import time
import uuid
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from simulation.errors import InputError
from simulation.file_lock import FileLock
from simulation.store.rows import Layout
from simulation.whole_file import whole_file

MANIFEST: Final = "_store.json"
SCHEMA: Final = 1
# Readers of a folder of Parquet files leave out names that begin with "_" or ".".
_README, _DAMAGED = "_README.txt", "_damaged"
_PREFIX, _SUFFIX, _PARTIAL = "part-", ".parquet", ".tmp"
# Parts of a tier are at most 16 times larger than those of the tier below; 16 of a tier become one part.
_TIERS: Final = (64 * 2**10, 2**20, 16 * 2**20)
_MERGED: Final = 16
_UNREADABLE: Final = "not readable; remove the file, the simulations beside it stay"
_README_TEXT: Final = """\
Every simulation of one model, one row each, in Parquet files. Read all of them with pandas:

    rows = pandas.read_parquet(".")             # in this folder

One column per parameter, named _parameter_... if an output has the same name. One column per output, whose
cells are series over the times that _store.json lists as time_s: numpy.stack(rows["{output}"]) is an array of
shape (rows, times). _failure says why a row failed and is empty where it is good. _written says when it was
simulated. _check guards the row against damage. A simulation that failed and was asked again may be there
twice: a good row counts before a failed one, then the newer one. Remove this folder, and everything is
simulated again.
"""


class StoreFolder:
    """The files of a store, shared with other processes."""

    def __init__(self, folder: Path, layout: Layout) -> None:
        """Make the folder, or check that it belongs to the model.

        Args:
            folder: Where the parts lie.
            layout: What its rows must be.

        Raises:
            InputError: If it belongs to another model or another version of this program.
        """
        self.path = Path(folder)
        self.path.mkdir(parents=True, exist_ok=True)
        self._pin(layout)
        self._remove_leftovers()

    def sizes(self) -> dict[str, int]:
        """Return names and sizes of all parts; names sort by time. [byte]."""
        # A listing is no snapshot: while parts are merged it may miss both the old and the new.
        found = self._listed()
        while (again := self._listed()) != found:
            found = again
        return found

    def _listed(self) -> dict[str, int]:
        sizes = {}
        with os.scandir(self.path) as entries:
            for entry in entries:
                if entry.name.startswith(_PREFIX) and entry.name.endswith(_SUFFIX):
                    try:
                        sizes[entry.name] = entry.stat().st_size
                    except FileNotFoundError:
                        continue
        return dict(sorted(sizes.items()))

    def publish(self, write: Callable[[BinaryIO], None], *, synced: bool = True) -> str:
        """Write a part, and only then let others see it.

        Args:
            write: Writes the content.
            synced: Whether it must be on the disk when this returns.

        Returns:
            The part's name.

        Raises:
            OSError: If it cannot be written; nothing is left of it.
        """
        name = f"{_PREFIX}{time.time_ns():020d}-{uuid.uuid4().hex[:8]}{_SUFFIX}"
        partial = self.path / f".{name}{_PARTIAL}"
        with self._writers(shared=True):
            try:
                with partial.open("xb") as file:
                    write(file)
                    file.flush()
                    if synced:
                        os.fsync(file.fileno())
                partial.replace(self.path / name)
            except BaseException:
                partial.unlink(missing_ok=True)
                raise
            if synced:
                self._sync()
        return name

    def remove(self, names: Iterable[str]) -> None:
        """Remove parts whose rows lie in another part now."""
        for name in names:
            (self.path / name).unlink(missing_ok=True)

    def set_aside(self, name: str) -> Path:
        """Move a damaged part to where nobody reads it.

        Returns:
            Its new place.
        """
        place = self.path / _DAMAGED / name
        place.parent.mkdir(exist_ok=True)
        # Another process may have seen the damage, too.
        with contextlib.suppress(FileNotFoundError):
            (self.path / name).replace(place)
        return place

    def merging(self) -> FileLock:
        """Return the lock of whoever merges parts."""
        return FileLock(self.path / ".merging")

    def _writers(self, *, shared: bool) -> FileLock:
        return FileLock(self.path / ".writers", shared=shared)

    def _remove_leftovers(self) -> None:
        """Remove what killed writers left, unless somebody writes now."""
        writers = self._writers(shared=False)
        if writers.try_acquire():
            try:
                for partial in self.path.glob(f".*{_PARTIAL}"):
                    partial.unlink(missing_ok=True)
            finally:
                writers.release()

    def _sync(self) -> None:
        """Bring names to the disk."""
        descriptor = os.open(self.path, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

    def _pin(self, layout: Layout) -> None:
        """Write the manifest, or check that it is this model's."""
        path = self.path / MANIFEST
        described = _describe(layout)
        if not path.exists():
            text = _README_TEXT.format(output=layout.output_names[0])
            with self._writers(shared=True):
                with whole_file(self.path / _README) as file:
                    file.write(text.encode())
                with whole_file(path, synced=True) as file:
                    file.write(json.dumps(described, indent=1).encode())
            return
        found = _manifest(path)
        for key, value in described.items():
            if found.get(key) != value:
                told, wanted = _short(found.get(key)), _short(value)
                raise InputError(
                    f"{path}: {key} is {told}, this model has {wanted}; remove the folder or name another one"
                )


def read_layout(folder: Path) -> Layout:
    """Read what the rows of an existing store have in common.

    Args:
        folder: The store's folder.

    Raises:
        InputError: If it is not there or not readable.
    """
    path = Path(folder) / MANIFEST
    if not path.is_file():
        raise InputError(f"{path}: no such file; simulate first")
    found = _manifest(path)
    try:
        return Layout(
            str(found["model_digest"]),
            tuple(found["parameters"]),
            tuple(found["outputs"]),
            np.array(found["time_s"], dtype=np.float64),
        )
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path}: {_UNREADABLE}") from None


def _manifest(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        found = None
    if not isinstance(found, dict):
        raise InputError(f"{path}: {_UNREADABLE}")
    return found


def groups_to_merge(sizes: dict[str, int]) -> list[list[str]]:
    """Choose parts that should become one: 16 of a size or more.

    Merging by size costs each row a few copies in all, however many rows there are and however few come at a
    time.

    Args:
        sizes: Names and sizes of all parts. [byte]

    Returns:
        Names, one list per new part.
    """
    tiers = np.searchsorted(_TIERS, list(sizes.values()), side="right")
    groups = []
    for tier in range(len(_TIERS)):
        names = [name for name, at in zip(sizes, tiers, strict=True) if at == tier]
        if len(names) >= _MERGED:
            groups.append(names)
    return groups


def _describe(layout: Layout) -> dict[str, Any]:
    times = np.ascontiguousarray(layout.time, dtype="<f8")
    return {
        "schema": SCHEMA,
        "model_digest": layout.model_digest,
        "parameters": list(layout.parameter_names),
        "outputs": list(layout.output_names),
        "time_sha256": hashlib.sha256(times.tobytes()).hexdigest(),
        "time_s": times.tolist(),
    }


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
