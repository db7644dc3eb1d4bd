"""Where the parts of an arena lie in its file, and who owns that file."""

import fcntl
import os
import struct
import tempfile
from pathlib import Path
from typing import Final

MAGIC: Final = b"arena-1\0"
# magic, boot id, names in bytes, capacity, rows in use, p, t, k
HEADER: Final = struct.Struct("<8s40s6q")
HEADER_BYTES: Final = 128
N_ROWS_AT: Final = 8 + 40 + 2 * 8
REASON_BYTES: Final = 1024
SUFFIX: Final = ".arena"
_PAGE: Final = 4096
_BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")


def layout(n_names: int, capacity: int, p: int, t: int, k: int) -> tuple[dict[str, int], int]:
    """Find where each part begins.

    Args:
        n_names: Bytes of the names, which follow the header.
        capacity: Rows.
        p: Parameters.
        t: Output times.
        k: Outputs.

    Returns:
        Where the parts begin, and the size of the whole. [bytes]
    """
    places, end = {}, HEADER_BYTES + n_names
    for name, size in (
        ("time", 8 * t),
        ("theta", 8 * capacity * p),
        ("started", 8 * capacity),
        ("wall_s", 8 * capacity),
        ("owners", 4 * capacity),
        ("states", capacity),
        ("reasons", capacity * REASON_BYTES),
        ("y", 8 * capacity * t * k),
    ):
        step = _PAGE if name == "y" else 64
        places[name] = -(-end // step) * step
        end = places[name] + size
    return places, end


def new_file(spool: Path | None) -> tuple[int, Path | None]:
    """Open a new file, locked as long as this process lives where it has a name.

    Args:
        spool: Its folder, made where it is missing; None for memory without a name.

    Returns:
        The open file, and where it is.
    """
    if spool is None:
        return os.memfd_create("arena", os.MFD_CLOEXEC), None
    spool.mkdir(parents=True, exist_ok=True)
    descriptor, name = tempfile.mkstemp(prefix=f"{os.getpid()}-", suffix=SUFFIX, dir=spool)
    if owned(descriptor):
        return descriptor, Path(name)
    # Whoever recovers arenas was faster, and removes this one: it is empty.
    os.close(descriptor)
    return new_file(spool)


def owned(descriptor: int) -> bool:
    """Become the owner of a file.

    Args:
        descriptor: The open file.

    Returns:
        Whether this process owns it now: False where another does, or where it has been removed.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return os.fstat(descriptor).st_nlink > 0


def boot_id() -> bytes:
    """Return a name for the time since this machine was started; empty where the system has none."""
    try:
        return _BOOT_ID.read_text().strip().encode()
    except OSError:
        return b""
