"""What a user reads when the machine is in the way: a full disk, a missing permission, no memory."""

import errno
import re
import resource
from collections.abc import Iterator
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


_NO_MEMORY = re.compile(r"allocate memory|failed to map segment|start new thread|shared object")

LEAST_MB = 1200
"""Address space in which a case is calibrated; with half of it, SciPy's OpenBLAS hangs when it is loaded."""


def check_surroundings() -> None:
    """Refuse to begin where every command would fail or hang somewhere deep inside.

    Raises:
        MachineError: a process may have too little memory, or the working folder was deleted.
    """
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most != resource.RLIM_INFINITY and most / 1e6 < LEAST_MB:
        raise MachineError(
            f"a process may have {most / 1e6:.0f} MB here, and {LEAST_MB} are needed; allow more (ulimit -v)"
        )
    try:
        Path.cwd()
    except OSError:
        raise MachineError("the working folder was deleted; go to another folder (cd)") from None


def explain(error: BaseException) -> str | None:
    """Say in one line what is in the way and the remedy; None where the error is something else."""
    if isinstance(error, MemoryError):
        said = " ".join(str(error).split()) or "the memory is exhausted"
        return f"too little memory: {said}; take fewer samples, longer steps or fewer --jobs"
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most != resource.RLIM_INFINITY and any(_NO_MEMORY.search(str(one)) for one in _chain(error)):
        return f"too little memory: a process may have {most / 1e6:.0f} MB here; allow more (ulimit -v)"
    if isinstance(error, OSError) and error.errno in _REMEDIES:
        where = f": {error.filename}" if error.filename else ""
        return f"{error.strerror}{where}; {_REMEDIES[error.errno]}, then type the command again"
    return None


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """Return an error and what it came from."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
