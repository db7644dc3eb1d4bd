"""Temporary folders for unpacked FMUs that are gone when the process is, even when it was killed."""

import contextlib
import os
import shutil
import stat
import sys
import tempfile
import zipfile
import zlib
from pathlib import Path, PurePosixPath

from simulation.errors import InputError
from simulation.fmi.declared import PLATFORM_FOLDERS

if sys.platform != "win32":
    import fcntl

_PREFIX = "simulation-fmu-"
_LOCK = ".lock"
# What zipfile raises on a member that is damaged, cut off, encrypted or of an unknown compression.
_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError)


class UnpackedFmu:
    """The part of an FMU that running it needs, in a folder of its own.

    A folder for each process and no shared one: some FMUs write beside their resources, and a library that
    is loaded twice from one file shares its variables. A living owner holds a lock on a file beside its
    folder, which the system lets go when the process dies in any way; remove_orphans() removes the folders
    of the dead, and is called whenever an FMU is unpacked.
    """

    def __init__(self, path: Path) -> None:
        """Unpack an FMU.

        Args:
            path: The FMU.

        Raises:
            InputError: If a member of the archive is damaged, a link, or would land outside the folder, or
                the disk is full.
        """
        remove_orphans()
        self._lock_file, self._lock = _locked_file()
        self._held = True
        self.folder = self._lock_file.with_suffix("")
        try:
            self.folder.mkdir(mode=0o700)
            _unpack(path, self.folder)
        except BaseException as error:
            self.remove()
            if isinstance(error, _DAMAGED):
                raise InputError(f"{path}: cannot be unpacked ({error}); export it again") from None
            if isinstance(error, OSError):
                raise InputError(
                    f"{path}: cannot be unpacked to {self.folder.parent} ({error.strerror}); free some space "
                    "or name another folder in the environment variable TMPDIR"
                ) from None
            raise

    def remove(self) -> None:
        """Remove the folder; removing it twice does no harm."""
        if not self._held:
            return
        shutil.rmtree(self.folder, ignore_errors=True)
        # The lock goes last: until then, nobody else may take the folder for an orphan, or for new.
        with contextlib.suppress(OSError):
            self._lock_file.unlink()
        os.close(self._lock)
        self._held = False


def remove_orphans() -> None:
    """Remove the folders whose processes are gone; those of living ones stay."""
    if sys.platform == "win32":
        # Windows has no such locks, and removes its temporary files by itself.
        return
    for file in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*{_LOCK}"):
        with contextlib.suppress(OSError):
            handle = os.open(file, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(file.with_suffix(""), ignore_errors=True)
                file.unlink()
            finally:
                os.close(handle)


def _locked_file() -> tuple[Path, int]:
    """Make a file of a new name that this process holds locked."""
    while True:
        handle, name = tempfile.mkstemp(prefix=_PREFIX, suffix=_LOCK)
        if sys.platform == "win32":
            return Path(name), handle
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Another process may have taken it for an orphan just before.
            if os.fstat(handle).st_nlink:
                return Path(name), handle
        os.close(handle)


def _unpack(path: Path, folder: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            name = member.filename
            parts = PurePosixPath(name.replace("\\", "/")).parts
            if ".." in parts or name.startswith(("/", "\\")) or (parts and ":" in parts[0]):
                raise InputError(
                    f"{path}: holds the member {name!r}, which points outside; do not trust this FMU"
                )
            needed = parts[:1] in {("modelDescription.xml",), ("resources",)}
            if not needed and (parts[:1] != ("binaries",) or parts[1:2] not in _PLATFORMS):
                continue
            mode = member.external_attr >> 16
            if stat.S_ISLNK(mode):
                raise InputError(
                    f"{path}: holds the member {name!r}, which is a link; pack the file itself into the FMU"
                )
            target = Path(archive.extract(member, folder))
            # zipfile forgets that a resource is a program.
            if mode & stat.S_IXUSR and target.is_file():
                target.chmod(0o700)
    # The FMU is told the address of this folder, present or not.
    (folder / "resources").mkdir(exist_ok=True)


_PLATFORMS = {(name,) for name in PLATFORM_FOLDERS.values()}
