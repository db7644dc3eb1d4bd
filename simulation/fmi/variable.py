"""The parts of an FMU's description: its variables, its interfaces, the experiment it suggests."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np

Interface = Literal["co-simulation", "model-exchange"]
FmiVersion = Literal["2.0", "3.0"]

Value = float | int | bool | str

REAL_KINDS: Final = ("Real", "Float64", "Float32")
# The function that sets variables of a kind and the C type of its values, None for text; by FMI version.
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


@dataclass(frozen=True)
class FmuVariable:
    """One variable of the model description.

    Attributes:
        name: Name.
        reference: Value reference.
        causality: "parameter", "structuralParameter", "input", "output", "local", ...
        kind: "Real", "Integer", "Boolean", "String", "Enumeration"; in FMI 3.0 "Float64", ...
        unit: Declared unit, "" for none.
        start: Start value, None when it has none or is no number. [unit]
        minimum: Declared minimum, None for none. [unit]
        maximum: Declared maximum, None for none. [unit]
        description: What the variable means, "" for nothing said.
        variability: "constant", "fixed", "tunable", "discrete" or "continuous".
        initial: "exact", "approx" or "calculated"; "" for nothing said.
        start_text: Start value as it is written, "" for none.
        shape: Dimensions of an array, () for a scalar.
        items: Numbers of an enumeration by their names.
        is_difference: Whether its values are differences of quantities: 1 degC is 1 K then.
    """

    name: str
    reference: int
    causality: str
    kind: str
    unit: str
    start: float | None
    minimum: float | None
    maximum: float | None
    description: str
    variability: str = "continuous"
    initial: str = ""
    start_text: str = ""
    shape: tuple[int, ...] = ()
    items: Mapping[str, int] = field(default_factory=dict)
    is_difference: bool = False

    @property
    def is_start_value(self) -> bool:
        """Whether it is no parameter, and yet its value at the start may be set: an initial state."""
        return (
            self.causality in ("local", "output")
            and self.initial == "exact"
            and self.variability != "constant"
        )

    @property
    def is_out_of_reach(self) -> bool:
        """Whether nothing here can set or read it: an array, a clock, bytes."""
        return bool(self.shape) or self.kind in ("Binary", "Clock")


@dataclass(frozen=True)
class FmuInterface:
    """One of the ways an FMU can be driven.

    Attributes:
        model_identifier: Name of the binary.
        can_get_and_set_state: Whether its state can be saved and brought back.
        can_be_instantiated_only_once_per_process: Whether it allows one instance at a time.
        needs_execution_tool: Whether it needs the tool that made it.
    """

    model_identifier: str
    can_get_and_set_state: bool = False
    can_be_instantiated_only_once_per_process: bool = False
    needs_execution_tool: bool = False


@dataclass(frozen=True)
class DefaultExperiment:
    """What an FMU suggests for a simulation; None where it says nothing.

    Attributes:
        start_s: Start. [s]
        stop_s: End. [s]
        step_s: Communication step. [s]
        tolerance: Relative tolerance of its solver.
    """

    start_s: float | None = None
    stop_s: float | None = None
    step_s: float | None = None
    tolerance: float | None = None
