"""Texts of others, as names, titles and messages: without signs that a terminal obeys, and not endless."""

import json
import re

MOST_QUOTED = 200
"""Characters of a file that a message quotes; what is longer is cut."""
# C0, DEL, C1, separators of lines, and what turns the direction of writing.
_OBEYED = "\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
_CONTROL = re.compile(f"[{_OBEYED}]")
_CONTROL_IN_LINES = re.compile(f"(?![\\n\\t])[{_OBEYED}]")


def escaped(text: str, *, keep_lines: bool = False) -> str:
    r"""Return a text with the signs that a terminal obeys written out, as \x1b.

    Args:
        text: The text.
        keep_lines: Whether ends of lines and tabulators stay.
    """
    pattern = _CONTROL_IN_LINES if keep_lines else _CONTROL
    return pattern.sub(lambda sign: sign[0].encode("unicode_escape").decode(), text)


def has_control(text: str) -> bool:
    """Return whether a text has a sign that a terminal obeys, or an end of a line."""
    return _CONTROL.search(text) is not None


def quoted(value: object) -> str:
    """Return what a message quotes of a value in a file: as Python writes it, cut where it is long."""
    try:
        return shortened(repr(value))
    except ValueError:  # Python writes no integer of thousands of digits
        return "a number of thousands of digits"


def shortened(text: str, most: int = MOST_QUOTED) -> str:
    """Return a text that is cut where it is longer than messages quote, with control signs written out.

    Args:
        text: The text.
        most: Characters that are kept.
    """
    text = escaped(text[: most + 1])
    return text if len(text) <= most else f"{text[: most - 3]}..."


def not_a_formula(text: str) -> str:
    """Return a text for a cell of CSV, with an apostrophe before what a spreadsheet would compute."""
    return f"'{text}" if text.lstrip()[:1] in ("=", "+", "-", "@") else text


def without_pictures(markdown: str) -> str:
    """Return a note in Markdown without pictures and HTML, which a browser would fetch from others."""
    return markdown.replace("![", "!\\[").replace("<", "&lt;")


def toml_text(text: str) -> str:
    """Return a text as a string of TOML, whose escapes are JSON's; DEL is escaped as well.

    Args:
        text: The text.
    """
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
