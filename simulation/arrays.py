"""Names for the array types that cross the walls between modules, and what their content is known by."""

import hashlib

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]


def digest_of(*parts: str | npt.NDArray[np.generic]) -> str:
    """Return the SHA-256 of texts and arrays of numbers (as 64-bit floats, without shape), in hexadecimal."""
    content = hashlib.sha256()
    for part in parts:
        content.update(
            part.encode() if isinstance(part, str) else np.ascontiguousarray(part, dtype="<f8").tobytes()
        )
    return content.hexdigest()
