"""How sizes and ages are said."""

import re

from simulation.errors import InputError

_UNITS = ("B", "KiB", "MiB", "GiB", "TiB")
_SECONDS = {"m": 60.0, "h": 3600.0, "d": 86400.0, "w": 7 * 86400.0}


def readable(size: float) -> str:
    """Return a number of bytes as people say it."""
    for unit in _UNITS:
        if size < 1000 or unit == _UNITS[-1]:
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1024
    raise AssertionError("unreachable")


def age(text: str) -> float:
    """Read an age such as 30d, 12h, 90m or 2w. [s].

    Raises:
        InputError: it is none.
    """
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([mhdw])", text.strip())
    if found is None:
        raise InputError(f"--older-than {text!r} is no age; write for example 30d, 12h, 90m or 2w")
    return float(found[1]) * _SECONDS[found[2]]
