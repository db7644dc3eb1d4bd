"""Errors of one line for the user: their own files and options are wrong, or the machine is in the way."""

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line that says what, where and what to do."""


class MachineError(InputError):
    """The machine is in the way: also one line, but once it is put right, the same command will do."""


@contextmanager
def errors_at(place: object) -> Iterator[None]:
    """Begin the message of any InputError of the block with a place, as the path of a file."""
    try:
        yield
    except InputError as error:
        raise type(error)(f"{place}: {error}") from None


class OutOfTimeError(RuntimeError):
    """Rows were not begun, as the time of their model is over; what has finished was handed over."""


class ReuseError(RuntimeError):
    """Simulations of one process depended on each other; those that may be wrong are removed.

    From then on each simulation has a process of its own. Whatever was concluded from the removed ones is to
    be done again.
    """
