"""What a user reads when the machine is in the way: a full disk, a missing permission, no memory."""

import errno
from pathlib import Path

from simulation.errors import MachineError

_REMEDIES = {
    errno.EACCES: "allow reading and writing there",
    errno.EPERM: "allow reading and writing there",
    errno.EROFS: "allow reading and writing there",
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space",
    errno.EFBIG: "allow larger files (ulimit -f)",
    errno.ENOTDIR: "move away the file that stands where a folder should be",
    errno.EISDIR: "move away the folder that stands where a file should be",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENFILE: "raise the limit of open files (ulimit -n)",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def check_surroundings() -> None:
    """Refuse to begin where every command would fail somewhere deep inside.

    Raises:
        MachineError: the working folder was deleted.
    """
    try:
        Path.cwd()
    except OSError:
        raise MachineError("the working folder was deleted; go to another folder (cd)") from None


def explain(error: BaseException) -> str | None:
    """Say in one line what is in the way and the remedy; None where the error is something else."""
    if isinstance(error, MemoryError):
        said = " ".join(str(error).split()) or "the memory is exhausted"
        return f"too little memory: {said}; take fewer samples, longer steps or fewer --jobs"
    if isinstance(error, OSError) and error.errno in _REMEDIES:
        where = f": {error.filename}" if error.filename else ""
        return f"{error.strerror}{where}; {_REMEDIES[error.errno]}, then type the command again"
    return None
