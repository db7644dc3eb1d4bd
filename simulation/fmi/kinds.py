"""The types of an FMU's variables: which function sets one, and which C type its values have."""

from typing import Any, Final

import numpy as np

# Function and C type (None for text) of each kind, by FMI version.
SETTERS: Final[dict[str, dict[str, tuple[str, Any]]]] = {
    "fmi2": {
        "Real": ("SetReal", np.float64),
        "Integer": ("SetInteger", np.int32),
        "Enumeration": ("SetInteger", np.int32),
        "Boolean": ("SetBoolean", np.int32),
        "String": ("SetString", None),
    },
    "fmi3": {
        "Float64": ("SetFloat64", np.float64),
        "Float32": ("SetFloat32", np.float32),
        "Enumeration": ("SetInt64", np.int64),
        "Boolean": ("SetBoolean", np.uint8),
        "String": ("SetString", None),
        **{
            f"{sign}Int{bits}": (f"Set{sign}Int{bits}", np.dtype(f"{sign.lower()}int{bits}").type)
            for sign in ("", "U")
            for bits in (8, 16, 32, 64)
        },
    },
}
