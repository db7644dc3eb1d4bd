"""What keywords and options may be; anything else is refused in one line."""

import argparse
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any, Literal, get_args

from simulation.errors import InputError

Method = Literal["adaptive", "paper"]
Surrogate = Literal["state-space", "refined", "paper", "pca-gp"]
Noise = Literal["correlated", "white", "sensor"]
Criterion = Literal["half-widths", "A", "D"]


@dataclass(frozen=True)
class Window:
    """A part of the recording.

    Attributes:
        begin: Its begin. [unit]
        end: Its end. [unit]
        unit: s, min, h or d.
    """

    begin: float
    end: float
    unit: str = "d"

    @property
    def days(self) -> tuple[float, float]:
        """Begin and end. [d]."""
        # Here, because the command line imports nothing heavy.
        from simulation.time_unit import UNITS

        return UNITS[self.unit].to_days(self.begin), UNITS[self.unit].to_days(self.end)

    @property
    def label(self) -> str:
        """How results of this window are distinguished: d8-16."""
        return f"{self.unit}{_all_digits(self.begin)}-{_all_digits(self.end)}"

    def __str__(self) -> str:
        """Return what can be typed."""
        return f"{_all_digits(self.begin)}-{_all_digits(self.end)}{'' if self.unit == 'd' else self.unit}"


def _all_digits(value: float) -> str:
    """Write a number without an exponent, which the reader of windows refuses."""
    return f"{Decimal(repr(value)).normalize():f}"


def window(text: str) -> Window:
    """Read two ascending days, 0-10, or times of another unit, 0-10s."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)(s|min|h|d)?", text)
    if found is None or float(found[1]) >= float(found[2]):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no window; give two ascending days, e.g. 0-10, or with a unit: 0-600s, 2-8h"
        )
    return Window(float(found[1]), float(found[2]), found[3] or "d")


def whole(least: int, most: int = 1_000_000) -> Callable[[str], int]:
    """Return a reader of whole numbers between two limits."""

    def read(text: str) -> int:
        if not re.fullmatch(r"\d+", text) or int(text) < least:
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number of at least {least}")
        if int(text) > most:
            raise argparse.ArgumentTypeError(f"{text!r} is too large; give {most} at most")
        return int(text)

    return read


def positive(text: str) -> float:
    """Read a positive number."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text!r} is not a positive number")
    return value


def address(text: str) -> str:
    """Read the address of a Dask scheduler."""
    if not re.fullmatch(r"(tcp|tls|ws|wss)://\S+:\d+", text):
        raise argparse.ArgumentTypeError(
            f"{text!r} is no scheduler's address; give e.g. tcp://scheduler:8786"
        )
    return text


READERS: dict[str, Callable[[str], Any]] = {
    "seed": whole(0, 2**32 - 1),
    "jobs": whole(1),
    "dask": address,
    "window": window,
    "n_train": whole(4),
    "trials": whole(1),
    "simulations": whole(16),
    "parallel": whole(1, 1000),
    "max_hours": positive,
    "max_minutes": positive,
    "max_calls": whole(1),
    "target": positive,
}
"""Reads the value of a keyword, or of the option of that name, from text."""
CHOICES: dict[str, tuple[str, ...]] = {
    "surrogate": get_args(Surrogate),
    "method": get_args(Method),
    "noise": get_args(Noise),
    "criterion": get_args(Criterion),
}
"""The words that others may be."""
OF_THE_MOMENT = ("again", "console", "case")
"""Keywords that a record does not give again: they change no result, and the case comes first."""


def check(verb: str, given: Mapping[str, Any]) -> None:
    """Refuse values that the command line would refuse, too.

    Args:
        verb: What was called.
        given: Its keywords; None stands for the default.

    Raises:
        InputError: One of them is wrong.
    """
    for name, value in given.items():
        if value is None or isinstance(value, Window):
            continue
        if name in CHOICES and value not in CHOICES[name]:
            raise InputError(f"{verb}(): {name}: {value!r} is none of {', '.join(CHOICES[name])}")
        if name in READERS:
            is_list = isinstance(value, (list, tuple)) and name != "window"
            for each in value if is_list else [value]:
                _check(f"{verb}(): {name}", name, each)


def _check(where: str, name: str, value: Any) -> None:
    try:
        read = READERS[name](as_text(value))
    except argparse.ArgumentTypeError as error:
        raise InputError(f"{where}: {error}") from None
    if isinstance(value, str) and not isinstance(read, (str, Window)):
        raise InputError(f"{where}: {value!r} is a text; give the number")


def as_text(value: Any) -> str:
    """Write a value as the command line has it; a window may be two days, inputs may be a frame.

    Args:
        value: Of a keyword.
    """
    if isinstance(value, tuple):
        return "-".join(map(str, value))
    return "FRAME" if hasattr(value, "to_csv") else str(value)


def typed(verb: str, given: Mapping[str, Any], defaults: Mapping[str, Any]) -> str:
    """Return the command line that does what a call with keywords does.

    Args:
        verb: What is called.
        given: Its keywords.
        defaults: What is not written, by keyword.
    """
    # The function for `studies next` has another name, as next() is Python's own.
    words = ["studies", verb.partition("_")[0], *([str(given["case"])] if given["case"] else [])]
    for name, value in given.items():
        option = f"--{name.replace('_', '-')}"
        is_plain = isinstance(value, (str, int, float))
        if name in OF_THE_MOMENT or value is None or (is_plain and value == defaults.get(name)):
            continue
        if value is True:
            words.append(option)
        elif value is False:
            words.append(option.replace("--", "--no-", 1))
        elif isinstance(value, (list, tuple)) and name != "window":
            words += [option, *map(str, value)]
        else:
            words += [option, as_text(value)]
    return shlex.join(words)
