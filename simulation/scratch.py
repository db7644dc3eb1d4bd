"""Temporary folders that are gone when their process is, at the latest when the next one is made."""

import contextlib
import fcntl
import os
import shutil
import tempfile
import time
from pathlib import Path
from typing import Final

from simulation.errors import MachineError

_LOCK: Final = ".in-use"
UNSEEN_S: Final = 3600.0
"""A folder that is unseen for longer was left by an owner killed while making it, which takes no time. [s]"""


class ScratchFolder:
    """A temporary folder that a lock marks as in use; folders without their owner are swept on the way.

    Attributes:
        folder: The folder.
    """

    def __init__(self, prefix: str) -> None:
        """Make the folder, and remove those of the same prefix whose owner was killed.

        Args:
            prefix: How the names of these folders begin.

        Raises:
            MachineError: If there is no room for it.
        """
        self._lock: int | None = None
        unseen = None
        try:
            sweep(prefix)
            unseen = Path(tempfile.mkdtemp(prefix=f".{prefix}"))
            self._lock = os.open(unseen / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Nobody who sweeps ever meets it without its lock.
            self.folder = unseen.rename(unseen.with_name(unseen.name[1:]))
        except OSError as error:
            if unseen is not None:
                shutil.rmtree(unseen, ignore_errors=True)
            if self._lock is not None:
                os.close(self._lock)
            raise MachineError(
                f"no temporary folder can be made ({error}); make room or set TMPDIR to another place"
            ) from None

    def remove(self) -> None:
        """Remove the folder with all that is in it; removing it twice does no harm."""
        if self._lock is not None:
            shutil.rmtree(self.folder, ignore_errors=True)
            os.close(self._lock)
            self._lock = None


def sweep(prefix: str) -> None:
    """Remove the folders whose owners are gone; those of living ones stay.

    Args:
        prefix: How the names of these folders begin.
    """
    place = Path(tempfile.gettempdir())
    for folder in (*place.glob(f"{prefix}*"), *place.glob(f".{prefix}*")):
        with contextlib.suppress(OSError):
            # Everybody may make one in the temporary folder, or a link to somewhere else.
            if folder.lstat().st_uid != os.getuid() or folder.is_symlink():
                continue
            # Between its making and its lock an unseen one may belong to somebody.
            if folder.name.startswith(".") and time.time() - folder.stat().st_mtime < UNSEEN_S:
                continue
            lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)
