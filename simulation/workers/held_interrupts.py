"""Ctrl-C that waits until what is being made can be taken down again."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


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


@contextmanager
def interrupts_masked() -> Iterator[None]:
    """Hold Ctrl-C back, also in processes that are spawned meanwhile, until these call `ignore_interrupts`.

    A terminal sends it to all of them, and one that was just spawned would end in the middle of its imports.
    """
    # Starting it would unmask.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore_interrupts() -> None:
    """Let a worker process not heed Ctrl-C, which reaches the whole group: its parent decides."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
