"""Temporary folders that are gone when their process is, at the latest when the next one is made."""

import contextlib
import os
import shutil
import tempfile
import time
from pathlib import Path

from simulation.errors import MachineError
from simulation.file_lock import FileLock

_LOCK = ".in-use"
UNSEEN_S = 3600.0
"""A folder that is unseen for longer was left by an owner killed while making it, which takes no time. [s]"""


_is_own = False


def own_temporary_folder() -> None:
    """Say that the temporary folder of this process goes with it: nothing in it needs a lock or is swept."""
    global _is_own
    _is_own = True


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
        unseen, self._lock = None, None
        try:
            if _is_own:
                self.folder = Path(tempfile.mkdtemp(prefix=prefix))
                return
            sweep(prefix)
            unseen = Path(tempfile.mkdtemp(prefix=f".{prefix}"))
            self._lock = FileLock(unseen / _LOCK)
            self._lock.acquire()
            # So no sweep ever meets it without its lock.
            self.folder = unseen.rename(unseen.with_name(unseen.name[1:]))
        except (OSError, MachineError) as error:
            if unseen is not None:
                shutil.rmtree(unseen, ignore_errors=True)
            raise MachineError(
                f"no temporary folder can be made ({error}); make room or set TMPDIR to another place"
            ) from None

    def remove(self) -> None:
        """Remove the folder with all that is in it; removing it twice does no harm."""
        if self._lock is not None and self._lock.is_held:
            shutil.rmtree(self.folder, ignore_errors=True)
            self._lock.release()


def sweep(prefix: str) -> None:
    """Remove the folders whose owners are gone; those of living ones stay.

    Args:
        prefix: How the names of these folders begin.
    """
    place = Path(tempfile.gettempdir())
    for folder in (*place.glob(f"{prefix}*"), *place.glob(f".{prefix}*")):
        with contextlib.suppress(OSError, MachineError):
            # Everybody may make one in the temporary folder, or a link to somewhere else.
            if folder.lstat().st_uid != os.getuid() or folder.is_symlink():
                continue
            # Between its making and its lock a hidden one may belong to a living process.
            if folder.name.startswith(".") and time.time() - folder.stat().st_mtime < UNSEEN_S:
                continue
            lock = FileLock(folder / _LOCK)
            if lock.try_acquire():
                shutil.rmtree(folder, ignore_errors=True)
                lock.release()
