"""What FMUs complain about: the logger that they are given, and its last line."""

import contextlib
import ctypes
from typing import Any

import fmpy
from fmpy import fmi2, fmi3

_WARNING = 1  # fmi2Warning, fmi3Warning

# The last error and the last warning of any FMU of this process; one logger serves all, as fmpy's proxy can
# hold only one. Some tools log an assertion that ends a simulation as a warning.
_LAST: dict[bool, str] = {}  # by whether it is a warning


def last_message(form: str) -> str:
    """Return the last line that an FMU of this process complained with, else its last warning, "" for none.

    Args:
        form: What the line is put into, as ": {}".
    """
    said = _LAST.get(False) or _LAST.get(True)
    return form.format(said) if said else ""


def note_message(said: str) -> None:
    """Take note of what an FMU of another process complained with last; "" for nothing."""
    if said:
        _LAST[False] = " ".join(said.split())


def forget_messages() -> None:
    """Forget what was logged so far."""
    _LAST.clear()


def _remember(*arguments: Any) -> None:
    """Take note of a message: the environment, in FMI 2.0 the instance's name, status, category, message."""
    *_, status, _, message = arguments
    if status >= _WARNING and message:
        _LAST[status == _WARNING] = " ".join(message.decode("utf-8", "replace").split())


def _callbacks_2() -> Any:
    callbacks: Any = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(_remember)
    # The C library's own functions, not Python functions around them.
    callbacks.allocateMemory = ctypes.cast(fmpy.calloc, fmi2.fmi2CallbackAllocateMemoryTYPE)
    callbacks.freeMemory = ctypes.cast(fmpy.free, fmi2.fmi2CallbackFreeMemoryTYPE)
    # The proxy fills in the message's printf arguments; where there is none, they stay raw.
    with contextlib.suppress(Exception):
        from fmpy.logging import addLoggerProxy

        addLoggerProxy(ctypes.byref(callbacks))
    return callbacks


CALLBACKS_2 = _callbacks_2()
LOGGER_3 = fmi3.fmi3LogMessageCallback(_remember)
