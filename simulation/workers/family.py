"""Processes that end with others: what an FMU starts with its process, a server with its command."""

import contextlib
import ctypes
import os
import signal

import psutil

_SET_PDEATHSIG, _SET_CHILD_SUBREAPER = 1, 36  # of prctl(2)


def adopt_orphans() -> None:
    """Become the parent of all that descends from this process and whose own parent has ended.

    A daemon leaves its session, its group and its parent; it cannot leave this.
    """
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_with_parent() -> None:
    """Have the system ask this process to end (SIGTERM) when the one that started it is killed."""
    ctypes.CDLL(None).prctl(_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)


def kill_descendants(pid: int, *, but: frozenset[int] = frozenset()) -> None:
    """Kill what descends from a process, until nothing new turns up.

    Args:
        pid: The process.
        but: Children of it that stay, with all that they started.
    """
    seen: set[int] = set()
    with contextlib.suppress(psutil.Error):
        while True:
            children = [one for one in psutil.Process(pid).children() if one.pid not in but]
            found = {one.pid for child in children for one in (child, *child.children(recursive=True))}
            if not found - seen:
                return
            seen |= found
            for one in found:
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.kill(one, signal.SIGKILL)
            if pid == os.getpid():
                for child in children:
                    with contextlib.suppress(ChildProcessError):
                        os.waitpid(child.pid, 0)
