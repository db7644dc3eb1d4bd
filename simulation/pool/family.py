"""Processes that end with others: what an FMU starts with its process, a server with its command."""

import contextlib
import ctypes
import os
import signal
import traceback
from collections.abc import Callable, Collection
from pathlib import Path

import psutil

_SET_PDEATHSIG, _SET_CHILD_SUBREAPER = 1, 36  # of prctl(2)


def adopt_orphans() -> None:
    """Become the parent of all that descends from this process and whose own parent has ended.

    A daemon leaves its session, its group and its parent; it cannot leave this.
    """
    ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def end_with_parent(by: signal.Signals = signal.SIGTERM) -> None:
    """Have the system end this process when the thread that started it ends.

    Args:
        by: The signal.
    """
    ctypes.CDLL(None).prctl(_SET_PDEATHSIG, by, 0, 0, 0)


def kill_descendants(*, but: Collection[int] = ()) -> None:
    """Kill what descends from this process, which has adopted orphans, until nothing new turns up.

    Args:
        but: Children that stay, with all that they started.
    """
    with contextlib.suppress(PermissionError):  # it runs as another user by now
        while pids := children() - set(but):
            for pid in pids:
                os.kill(pid, signal.SIGKILL)
            # All before any is waited for: what another one of them traces is seen to end by that one first.
            for pid in pids:
                # What it had started is a child of this process from now on.
                os.waitpid(pid, 0)


def children(parent: int | None = None) -> set[int]:
    """Return the ids of the processes whose parent is a process.

    Args:
        parent: Its id; None for this one.
    """
    # psutil looks at all processes of the machine, which takes as long as to fork.
    lists = list(Path(f"/proc/{parent or 'self'}/task").glob("*/children"))
    if not lists:
        return {one.pid for one in psutil.Process(parent).children()}
    return {int(pid) for one in lists for pid in one.read_text().split()}


def in_a_fork(function: Callable[[], object]) -> int:
    """Call a function in a fork of this process, which ends with it.

    Args:
        function: The function.

    Returns:
        The id of the fork.
    """
    pid = os.fork()
    if pid == 0:
        code = 70
        try:
            function()
            code = 0
        except Exception:
            traceback.print_exc()
        finally:
            os._exit(code)
    return pid
