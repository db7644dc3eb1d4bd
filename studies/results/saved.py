"""Results as files: a frozen dataclass goes to JSON and back, its arrays to an .npz file beside it."""

import functools
import hashlib
import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError

from simulation.errors import InputError
from simulation.foreign_file import RECORD, read_limited
from simulation.whole_file import whole_file
from studies.profile import in_one_line

Arrays = dict[str, NDArray[Any]]
WITH_ARRAYS = ConfigDict(arbitrary_types_allowed=True)
"""`__pydantic_config__` of a result that has arrays among its fields."""
Error = Annotated[float, BeforeValidator(lambda value: math.inf if value is None else value)]
"""A number that is infinite where a simulation failed; JSON has null there."""
T = TypeVar("T")
CHECKSUM = "checksum"
"""Key of a record's own checksum."""
# What may be half a character: JSON escapes one beyond the first 65,536 as two.
_SURROGATE = re.compile(rb"\\u[dD][89a-fA-F]")
# To make one takes longer than to read with it.
_reader = cast("Callable[[type], TypeAdapter[Any]]", functools.cache(TypeAdapter))


def plain(result: Any) -> dict[str, Any]:
    """Return a dataclass as JSON values without arrays and absent parts; null is not finite."""
    absent = {one.name for one in fields(result) if one.default is None and getattr(result, one.name) is None}
    written = _reader(type(result)).dump_json(result, exclude={*arrays_of(result), *absent})
    content: dict[str, Any] = json.loads(written)
    return content


def arrays_of(result: Any) -> Arrays:
    """Return the arrays among the fields of a dataclass."""
    return {name: value for name, value in vars(result).items() if isinstance(value, np.ndarray)}


def rebuilt(
    kind: type[T], content: object, owner: str, arrays: Mapping[str, NDArray[Any]] | None = None
) -> T:
    """Return the dataclass that `plain` and `arrays_of` took apart.

    Args:
        kind: the dataclass.
        content: its JSON values; may be a stranger's.
        owner: what they belong to, for the message.
        arrays: its arrays.

    Raises:
        InputError: the content is not that of such a dataclass.
    """
    whole = {**content, **(arrays or {})} if isinstance(content, dict) else content
    try:
        result: T = _reader(kind).validate_python(whole)
    except ValidationError as error:
        raise InputError(f"{owner}: {in_one_line(error)}; use the version that wrote it") from None
    return result


def read_json(file: Path) -> dict[str, Any] | None:
    """Return a JSON object, or None where there is no file that may be read.

    Raises:
        InputError: it is damaged, or a text in it has half a character, which no terminal, file or database
            takes.
    """
    try:
        text = read_limited(file, RECORD)
    except InputError:
        return None
    damaged = InputError(f"{file} is damaged; remove it and repeat its command")
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
    # Versions before 0.3 wrote none.
    if content.pop(CHECKSUM, None) not in (None, _checksum(content)):
        raise damaged
    return content


def write_json(file: Path, content: Mapping[str, Any]) -> None:
    """Write a JSON object in one step, safe against a crash: a reader sees the old file or the new one."""
    # As it is read again, so that the checksum is of the same.
    read: dict[str, Any] = json.loads(json.dumps(content, default=str))
    with whole_file(file, synced=True) as stream:
        stream.write(f"{json.dumps({**read, CHECKSUM: _checksum(read)}, indent=2)}\n".encode())


def _checksum(content: Mapping[str, Any]) -> str:
    """Return the SHA-256 of JSON values, whatever their order and blanks between them."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def write_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write an .npz file in one step."""
    with whole_file(file) as stream:
        np.savez_compressed(stream, allow_pickle=False, **{name: np.asarray(a) for name, a in arrays.items()})


def read_arrays(file: Path) -> Arrays:
    """Read an .npz file.

    Raises:
        InputError: it is damaged.
    """
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)
    except OSError:
        raise
    except Exception:  # damaged bytes reach the readers of zip files, of headers and of arrays
        raise InputError(f"{file} is damaged; remove it and repeat its command") from None
