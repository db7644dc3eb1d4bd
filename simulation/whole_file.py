"""Files that are written whole or not at all."""

import fcntl
import glob
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from simulation.write_gate import check_written


@contextmanager
def whole_file(path: Path, *, synced: bool = False) -> Iterator[BinaryIO]:
    """Open a file that takes its place when the block ends without an error.

    A killed process leaves the old file or the new one, never half of one. What it had written beside it is
    removed when the file is written next.

    Args:
        path: File to write; its folder is created when missing.
        synced: Whether the content shall be on the disk first, safe against a crash of the machine.

    Yields:
        The file, open for writing bytes.

    Raises:
        InputError: If a link leads it out of the project.
    """
    check_written(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove_left(path)
    file, partial = _begin(path)
    try:
        with file:
            yield file
            file.flush()
            if synced:
                os.fsync(file.fileno())
            partial.replace(path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def _begin(path: Path) -> tuple[BinaryIO, Path]:
    """Open a new file beside a path, with a lock that ends with this process."""
    while True:
        partial = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.tmp")
        file = partial.open("wb")
        with suppress(OSError):  # a file system without locks, on which leftovers stay
            fcntl.flock(file, fcntl.LOCK_EX)
        if os.fstat(file.fileno()).st_nlink:
            return file, partial
        file.close()  # another process has removed it before the lock was there


def _remove_left(path: Path) -> None:
    """Remove what killed processes left of a file; what a living one writes is locked."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        with suppress(OSError), left.open("r+b") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            left.unlink()
