"""Ctrl-C that nobody can swallow: one lost in a library's bare `except` is raised again at the next step."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_pressed = threading.Event()


@contextmanager
def ctrl_c_heard() -> Iterator[None]:
    """Remember in a block that Ctrl-C was pressed, whatever becomes of the KeyboardInterrupt it raises."""
    if threading.current_thread() is not threading.main_thread():
        # Only the main thread is interrupted.
        yield
        return
    _pressed.clear()
    before = signal.signal(signal.SIGINT, _on_ctrl_c)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def heed_ctrl_c() -> None:
    """Raise what was pressed and got lost; called wherever work can be left.

    Raises:
        KeyboardInterrupt: If Ctrl-C was pressed.
    """
    if _pressed.is_set():
        raise KeyboardInterrupt


def _on_ctrl_c(number: int, frame: FrameType | None) -> None:
    _pressed.set()
    raise KeyboardInterrupt
