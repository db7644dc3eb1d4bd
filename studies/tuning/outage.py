"""What is waited for and not fatal: a full disk, a database server that is away."""

import errno
import time
from collections.abc import Callable
from typing import TypeVar

from studies.tuning.postgres import StorageAwayError

_T = TypeVar("_T")


class StudyInterruptedError(Exception):
    """This process was asked to stop; the trial it was about will be run again."""


FIRST_PAUSE_S = 0.1
LONGEST_PAUSE_S = 5.0
_FULL = (errno.ENOSPC, errno.EDQUOT)


def cause(error: BaseException) -> str | None:
    """Say in one line what is in the way if it may pass; None for an error that will not."""
    if isinstance(error, StorageAwayError):
        return str(error)
    if isinstance(error, OSError) and error.errno in _FULL:
        where = f": {error.filename}" if error.filename else ""
        return f"{error.strerror}{where}; free some space"
    return None


def wait_out(
    work: Callable[[], _T],
    *,
    tell: Callable[[str], None],
    should_stop: Callable[[], bool] = lambda: False,
) -> _T:
    """Do something that may be done twice with the effect of once, however long its place is away.

    Args:
        work: what is done.
        tell: told what is waited for once it has failed, and an empty line when it has succeeded after that.
        should_stop: asked between two attempts.

    Raises:
        StudyInterruptedError: `should_stop` said so.
    """
    pause_s, is_waiting = FIRST_PAUSE_S, False
    while True:
        try:
            result = work()
        except Exception as error:
            line = cause(error)
            if line is None:
                raise
            if should_stop():
                raise StudyInterruptedError from error
            if not is_waiting:
                tell(line)
                is_waiting = True
        else:
            if is_waiting:
                tell("")
            return result
        _sleep(pause_s, should_stop)
        pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)


def _sleep(pause_s: float, should_stop: Callable[[], bool]) -> None:
    end = time.monotonic() + pause_s
    while (left := end - time.monotonic()) > 0 and not should_stop():
        time.sleep(min(left, 0.1))
