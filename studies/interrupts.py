"""Ctrl-C that is not lost on its way to what handles it."""

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

_LOOK_AFTER_S = 0.25


@contextmanager
def interrupts_kept() -> Iterator[None]:
    """Interrupt again where a Ctrl-C came to nothing.

    Python raises KeyboardInterrupt wherever it is, also in code that drops whatever is raised in it: in a
    `__del__`, or in what NumPy asks of Python when it makes a dtype. The work would go on as if no key had
    been pressed. So a moment later it is raised again, unless it is handled by then.

    Only on the main thread, where Ctrl-C means KeyboardInterrupt and nothing else waits for the timer:
    otherwise nothing is changed.
    """
    if (
        threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
        or signal.getsignal(signal.SIGALRM) is not signal.SIG_DFL
    ):
        yield
        return
    hook = sys.unraisablehook
    signal.signal(signal.SIGALRM, _look_again)
    signal.signal(signal.SIGINT, _interrupt)
    try:
        yield
    finally:
        interrupt_handled()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        sys.unraisablehook = hook


def interrupt_handled() -> None:
    """Say that a Ctrl-C is known to whoever it was meant for, and is not to be raised again."""
    if signal.getsignal(signal.SIGALRM) is _look_again:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def is_interrupt(error: BaseException | None) -> bool:
    """Say whether an error is a Ctrl-C, or was raised while one was on its way."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None


def _interrupt(number: int, frame: object) -> NoReturn:
    signal.setitimer(signal.ITIMER_REAL, _LOOK_AFTER_S)
    # What is left half made may complain when it is freed, as a ZIP file does.
    sys.unraisablehook = _say_nothing
    raise KeyboardInterrupt


def _look_again(number: int, frame: object) -> None:
    # What is handled here is what the interrupted code handles: an except, a finally, the end of a with. A
    # generator that is dropped on the way tidies up without knowing why.
    error = sys.exception()
    if is_interrupt(error) or isinstance(error, GeneratorExit):
        signal.setitimer(signal.ITIMER_REAL, _LOOK_AFTER_S)
    else:
        # Not raised from here: a caller may hold Ctrl-C back.
        signal.raise_signal(signal.SIGINT)


def _say_nothing(dropped: object) -> None:
    pass
