"""A lock on a file that the operating system releases when its owner dies, however it dies."""

import errno
import fcntl
import os
import time
from pathlib import Path

from simulation.errors import MachineError
from simulation.write_gate import check_written

# What systems report of a lock that another process holds.
_HELD = {errno.EAGAIN, errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK}


class FileLock:
    """A lock between processes, held through an open file.

    A lock that is a mere file outlives a killed owner; this one does not, so that whoever gets it knows that
    no living process holds it.

    Args:
        file: the file to lock; created empty where absent, never removed.

    Raises:
        InputError: a link leads it out of the project.
    """

    def __init__(self, file: Path) -> None:
        check_written(file)
        self._file = file
        self._descriptor: int | None = None

    def try_acquire(self) -> bool:
        """Take the lock if no other process is in the way; return whether it is held now.

        Raises:
            MachineError: If there are no locks where the file lies.
        """
        if not self._file.parent.is_dir():
            self._file.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            os.close(descriptor)
            if error.errno in _HELD:
                return False
            raise MachineError(
                f"{self._file}: this file system has no locks ({error.strerror}); work on a local disk"
            ) from error
        self._descriptor = descriptor
        return True

    @property
    def is_held(self) -> bool:
        """Whether this object holds the lock."""
        return self._descriptor is not None

    def acquire(self) -> None:
        """Wait until the lock is held."""
        wait_s = 0.0005
        while not self.try_acquire():
            time.sleep(wait_s)
            wait_s = min(2.0 * wait_s, 0.02)

    def release(self) -> None:
        """Give the lock back; without effect where it is not held."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def __enter__(self) -> "FileLock":
        self.acquire()
        return self

    def __exit__(self, *_: object) -> None:
        self.release()
