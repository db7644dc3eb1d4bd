"""How moments, errors and hints are said where people look at their studies."""

import time
from collections.abc import Iterable
from difflib import get_close_matches

from studies.console import format_seconds
from studies.report.wording import MISSING, significant


def ago(moment_s: float, now_s: float | None = None) -> str:
    """Say how long ago a moment was.

    Args:
        moment_s: the moment; 0 where there was none. [s since 1970, UTC]
        now_s: now; None asks the clock. [s since 1970, UTC]
    """
    if not moment_s:
        return MISSING
    seconds = max((time.time() if now_s is None else now_s) - moment_s, 0.0)
    if seconds < 3.0:
        return "now"
    if seconds < 172_800.0:
        return f"{format_seconds(round(seconds))} ago".replace(".0 ", " ")
    return f"{seconds / 86_400.0:.0f} days ago"


def moment(moment_s: float) -> str:
    """Write a moment in local time."""
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(moment_s))


def error(value: float | None) -> str:
    """Write an error of a surrogate."""
    return MISSING if value is None else significant(value)


def hint(text: str, known: Iterable[str]) -> str:
    """Return a proposal for a misspelt name, with a blank behind it, or nothing."""
    close = get_close_matches(text, list(known), n=1, cutoff=0.5)
    return f"did you mean {close[0]}? " if close else ""
