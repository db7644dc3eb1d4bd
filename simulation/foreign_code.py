"""How long code of others may take while a model is opened; the process that it runs in ends with it."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager

ENDED_BY = signal.SIGALRM
"""Signal that ends a process in which code of others took too long."""
_limit_s = 0.0


@contextmanager
def opening_limited(limit_s: float | None) -> Iterator[None]:
    """Let code of others take so long at a time while this process opens a model.

    Only on the main thread of a process that may end.

    Args:
        limit_s: How long; None for ever. [s]
    """
    global _limit_s
    _limit_s = limit_s or 0.0
    try:
        yield
    finally:
        _limit_s = 0.0


@contextmanager
def foreign_code() -> Iterator[None]:
    """Run code of others, which may hang: where there is a limit, the system ends this process.

    No thread of Python could: a library that is being loaded keeps the interpreter's lock.
    """
    if not _limit_s:
        yield
        return
    signal.signal(ENDED_BY, signal.SIG_DFL)
    signal.setitimer(signal.ITIMER_REAL, _limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
