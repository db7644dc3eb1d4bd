"""Temporary folders that are gone when their process is, at the latest when the next one is made."""

import contextlib
import fcntl
import os
import shutil
import tempfile
import time
from pathlib import Path
from typing import Final

_LOCK: Final = ".in-use"
# A folder without a lock that is this young may be another process's that has not locked it yet.
_YOUNG_S: Final = 60.0


class ScratchFolder:
    """A temporary folder that a lock marks as in use; folders without their owner are swept on the way.

    Attributes:
        folder: The folder.
    """

    def __init__(self, prefix: str) -> None:
        """Make the folder, and remove those of the same prefix whose owner was killed.

        Args:
            prefix: How the names of these folders begin.
        """
        _sweep(prefix)
        self.folder = Path(tempfile.mkdtemp(prefix=prefix))
        self._lock = os.open(self.folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def remove(self) -> None:
        """Remove the folder with all that is in it."""
        shutil.rmtree(self.folder, ignore_errors=True)
        os.close(self._lock)


def _sweep(prefix: str) -> None:
    for folder in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        with contextlib.suppress(OSError):
            if time.time() - folder.stat().st_mtime < _YOUNG_S and not (folder / _LOCK).exists():
                continue
            lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(lock)
