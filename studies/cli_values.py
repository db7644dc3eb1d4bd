"""What the words of a command line may be; anything else is refused in one line."""

import argparse
import re
from collections.abc import Callable


def window(text: str) -> tuple[float, float]:
    """Read two ascending days, 0-10."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)-(\d+(?:\.\d+)?)", text)
    if found is None or float(found[1]) >= float(found[2]):
        raise argparse.ArgumentTypeError(f"{text!r} is no window; give two ascending days, e.g. 0-10")
    return float(found[1]), float(found[2])


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


def port(text: str) -> int:
    """Read the number of a port."""
    if not re.fullmatch(r"\d+", text) or not 1024 <= int(text) <= 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no port; give a number from 1024 to 65535")
    return int(text)
