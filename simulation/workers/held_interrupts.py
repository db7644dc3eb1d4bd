"""Ctrl-C that waits until what is being made can be taken down again."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def interrupts_held() -> Iterator[Callable[[], None]]:
    """Hold Ctrl-C back while a process is started: half of one would stay, with nobody who knows it.

    Yields:
        Lets a held Ctrl-C through, and those that follow; the end of the block does so too.
    """
    before = signal.getsignal(signal.SIGINT)
    # Only the main thread is interrupted, and only Python's handlers can be put back.
    if before is None or threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    came: list[int] = []
    signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    is_held = True

    def release() -> None:
        nonlocal is_held
        if is_held:
            is_held = False
            signal.signal(signal.SIGINT, before)
            if came:
                signal.raise_signal(signal.SIGINT)

    try:
        yield release
    finally:
        release()
