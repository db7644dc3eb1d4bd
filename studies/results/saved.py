"""Results as files: a frozen dataclass goes to JSON and back, its arrays to an .npz file beside it."""

import functools
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, ConfigDict, TypeAdapter, ValidationError

from simulation.errors import InputError
from simulation.record_file import REMEDY
from simulation.whole_file import whole_file

Arrays = dict[str, NDArray[Any]]
WITH_ARRAYS = ConfigDict(arbitrary_types_allowed=True)
"""`__pydantic_config__` of a result that has arrays among its fields."""
Error = Annotated[float, BeforeValidator(lambda value: math.inf if value is None else value)]
"""A number that is infinite where a simulation failed; JSON has null there."""
T = TypeVar("T")
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
        from studies.profile import in_one_line

        raise InputError(f"{owner}: {in_one_line(error)}; use the version that wrote it") from None
    return result


def write_arrays(file: Path, arrays: Mapping[str, Any]) -> None:
    """Write an .npz file in one step."""
    with whole_file(file) as stream:
        np.savez_compressed(stream, allow_pickle=False, **{name: np.asarray(a) for name, a in arrays.items()})


def read_arrays(file: Path, remedy: str = REMEDY) -> Arrays:
    """Read an .npz file.

    Args:
        file: the file.
        remedy: what to do where it is damaged.

    Raises:
        InputError: it is damaged.
    """
    try:
        with np.load(file, allow_pickle=False) as arrays:
            return dict(arrays)
    except OSError:
        raise
    except Exception:  # damaged bytes reach the readers of zip files, of headers and of arrays
        raise InputError(f"{file} is damaged; {remedy}") from None
