"""Temporary folders for unpacked FMUs that are gone when the process is, even when it was killed."""

import contextlib
import os
import shutil
import tempfile
import time
import zipfile
import zlib
from pathlib import Path, PurePosixPath

import fmpy

from simulation.errors import InputError

_PREFIX = "simulation-fmu-"
_LOCK = ".in-use"
# A folder this young may be another process's that has not locked it yet.
_YOUNG_S = 60.0
# What zipfile raises on a member that is damaged, cut off, encrypted or of an unknown compression.
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError)


class UnpackedFmu:
    """The part of an FMU that running it needs, in a folder of its own.

    Folders left by killed processes are swept when the next FMU is unpacked: a living owner holds a lock on
    a file in its folder, which the system lets go when the process dies in any way.
    """

    def __init__(self, path: Path) -> None:
        """Unpack an FMU.

        Args:
            path: The FMU.

        Raises:
            InputError: If a member of the archive is damaged or would land outside the folder.
        """
        _sweep()
        self.folder = Path(tempfile.mkdtemp(prefix=_PREFIX))
        try:
            self._lock = _lock(self.folder / _LOCK)
            _unpack(path, self.folder)
        except BaseException as error:
            shutil.rmtree(self.folder, ignore_errors=True)
            if isinstance(error, _DAMAGED):
                raise InputError(f"{path}: cannot be unpacked ({error}); export it again") from None
            raise

    def remove(self) -> None:
        """Remove the folder; removing it twice does no harm."""
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None
        shutil.rmtree(self.folder, ignore_errors=True)


def _unpack(path: Path, folder: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        for member in archive.namelist():
            parts = PurePosixPath(member.replace("\\", "/")).parts
            if ".." in parts or member.startswith(("/", "\\")) or (parts and ":" in parts[0]):
                raise InputError(
                    f"{path}: holds the member {member!r}, which points outside; do not trust this FMU"
                )
            needed = parts[:1] in {("modelDescription.xml",), ("resources",)}
            if needed or parts[:2] == ("binaries", fmpy.platform):
                archive.extract(member, folder)
    # fmpy hands the FMU the address of this folder, present or not.
    (folder / "resources").mkdir(exist_ok=True)


def _lock(path: Path) -> int | None:
    """Hold a lock on a file as long as this process lives; None where the system has no such locks."""
    try:
        import fcntl
    except ImportError:
        return None
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        raise
    return handle


def _sweep() -> None:
    """Remove folders whose owner is gone."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            if time.time() - folder.stat().st_mtime < _YOUNG_S:
                continue
            handle = _lock(folder / _LOCK)
            if handle is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(handle)
