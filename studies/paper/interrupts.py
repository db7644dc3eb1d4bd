"""Ctrl-C that does not reach processes which are being started."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker


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
