"""Records: JSON objects that this program reads again as the truth, each with a checksum of its own."""

import hashlib
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from simulation.errors import InputError
from simulation.foreign_file import RECORD, read_limited
from simulation.whole_file import whole_file

CHECKSUM = "checksum"
"""Key of a record's own checksum."""
REMEDY = "remove it and repeat its command"
"""For a damaged file of whose command nothing is known."""
# What may be half a character: JSON escapes one beyond the first 65,536 as two.
_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")


def read_json(file: Path, remedy: str = REMEDY) -> dict[str, Any] | None:
    """Return a JSON object without its checksum, or None where there is no file.

    Args:
        file: The record.
        remedy: What to do where it is damaged.

    Raises:
        InputError: If it cannot be read, is damaged, or a text in it has half a character, which no terminal,
            file or database takes.
    """
    try:
        text = read_limited(file, RECORD)
    except InputError:
        if file.exists():
            raise
        return None
    damaged = InputError(f"{file} is damaged; {remedy}")
    try:
        content = json.loads(text)
    except (ValueError, RecursionError):
        raise damaged from None
    if not isinstance(content, dict):
        raise damaged
    if _SURROGATE.search(text):
        try:
            json.dumps(content, ensure_ascii=False).encode()
        except UnicodeEncodeError as error:
            half = ascii(error.object[error.start])
            raise InputError(f"{file}: {half} is half a character; move the file away") from None
    # Earlier versions wrote none.
    if content.pop(CHECKSUM, None) not in (None, _checksum(content)):
        raise damaged
    return content


def write_json(file: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON object in one step, safe against a crash: a reader sees the old file or the new one."""
    with whole_file(file, synced=True) as stream:
        stream.write(f"{json.dumps(with_checksum(content), indent=2)}\n".encode())


def with_checksum(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return JSON values as they are read again, and their checksum."""
    read: dict[str, Any] = json.loads(json.dumps(content, default=str))
    return {**read, CHECKSUM: _checksum(read)}


def _checksum(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of JSON values, whatever their order and blanks between them."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
