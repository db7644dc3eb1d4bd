"""The parts of an FMU's description: its variables, its interfaces, the experiment it suggests."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.foreign_text import shortened

Interface = Literal["co-simulation", "model-exchange"]
FmiVersion = Literal["2.0", "3.0"]

Value = float | int | bool | str

REAL_KINDS = ("Real", "Float64", "Float32")
# The function that sets variables of a kind and the C type of its values, None for text; by FMI version.
SETTERS: dict[FmiVersion, dict[str, tuple[str, Any]]] = {
    "2.0": {
        "Real": ("SetReal", np.float64),
        "Integer": ("SetInteger", np.int32),
        "Enumeration": ("SetInteger", np.int32),
        "Boolean": ("SetBoolean", np.int32),
        "String": ("SetString", None),
    },
    "3.0": {
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

# What a value of a kind is, and its types; of all other kinds a whole number.
_VALUES: Mapping[str, tuple[str, tuple[type, ...]]] = {
    **dict.fromkeys(REAL_KINDS, ("a number", (float, int))),
    "Boolean": ("true or false", (bool,)),
    "String": ('a text in "quotes"', (str,)),
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
        setter: Function that sets it, without the version, "" for none.
        dtype: C type of its values, None for text and for what nothing sets.
        namesakes: Value references of other variables with the same name, which the standard forbids.
        array: Of an element, as `y[1]`, the start values of the whole array, whose reference it has; () else.
        element: Its place in that array, from 0 on.
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
    setter: str = ""
    dtype: Any = None
    namesakes: tuple[int, ...] = ()
    array: tuple[float, ...] = ()
    element: int = 0

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

    @property
    def elements(self) -> "tuple[FmuVariable, ...]":
        """An array's elements as variables of their own, `A[1,1]` to `A[m,n]`; of a scalar itself."""
        if not self.shape:
            return (self,)
        places = [*np.ndindex(self.shape)]
        words = self.start_text.split()
        texts = words if len(words) == len(places) else [words[0] if len(words) == 1 else ""] * len(places)
        starts = [_start_number(text) for text in texts]
        whole = tuple(0.0 if start is None else start for start in starts)
        return tuple(
            replace(
                self,
                name=f"{self.name}[{','.join(str(place + 1) for place in at)}]",
                start=start,
                start_text=text,
                shape=(),
                array=whole,
                element=k,
            )
            for k, (at, start, text) in enumerate(zip(places, starts, texts, strict=True))
        )

    def require_once(self, where: str) -> None:
        """Check that no other variable has its name.

        Args:
            where: What names it, for the message.

        Raises:
            InputError: If one has.
        """
        if self.namesakes:
            raise InputError(f"{where}: {self.twice}; give each variable a name of its own in the FMU")

    @property
    def twice(self) -> str:
        """How often its name stands in the description, and with which value references."""
        n = len(self.namesakes) + 1
        references = [*map(str, self.namesakes), str(self.reference)]
        said = f"{', '.join(references[:-1])} and {references[-1]}"
        often = "twice" if n == 2 else f"{n} times"
        return (
            f"{shortened(self.name)} stands {often} in modelDescription.xml, with the value references {said}"
        )

    def held_at(self, value: Value, where: str) -> Value:
        """Return a value as the variable takes it, the number of an item for its name.

        Args:
            value: The value. [FMU's unit]
            where: What gives it, for the message.

        Raises:
            InputError: If it does not fit the variable.
        """
        said = f"{where} = {str(value).lower() if isinstance(value, bool) else repr(value)}: {self.name}"
        if self.items:
            number = self.items.get(value) if isinstance(value, str) else value
            if type(number) is int and number in self.items.values():
                return number
            choice = shortened(", ".join(self.items), 1000)
            raise InputError(f"{said} has no such item; choose one of: {choice}")
        if self.kind in _VALUES:
            words, types = _VALUES[self.kind]
            # Not isinstance: True is an int for it.
            fits = type(value) in types
        else:
            low, high = self._limits
            words, fits = f"a whole number from {low} to {high}", type(value) is int and low <= value <= high
        if not fits:
            raise InputError(f"{said} is of type {self.kind}; give {words}")
        return float(value) if self.kind in REAL_KINDS else value

    def check_series(self, values: FloatArray, edges: FloatArray, source: str) -> None:
        """Check what drives an input: one that is no real number knows nothing in between.

        Args:
            values: Its values over the steps. Shape (m,). [FMU's unit]
            edges: Edges of the steps. Shape (m + 1,). [s]
            source: Where they come from, for the message.

        Raises:
            InputError: If one does not fit the variable.
        """
        if self.kind in REAL_KINDS:
            return
        allowed, words = [0, 1], "0 or 1"
        if self.items:
            allowed = list(self.items.values())
            words = "one of: " + ", ".join(f"{number} ({item})" for item, number in self.items.items())
        known = np.isin(values, allowed)
        if not self.items and self.kind != "Boolean":
            low, high = self._limits
            words = f"whole numbers from {low} to {high}"
            known = (values == np.rint(values)) & (values >= low) & (values <= high)
        for step in np.flatnonzero(~known)[:1]:
            raise InputError(
                f"{source} is {values[step]:g} at {edges[step]:.12g} s, and the FMU's {self.name} is of type "
                f"{self.kind}; give {words}"
            )

    @property
    def _limits(self) -> tuple[int, int]:
        limits = np.iinfo(self.dtype)
        return limits.min, limits.max


def _start_number(text: str) -> float | None:
    """Return a start value of an element as a number, None for none."""
    try:
        value = float({"true": "1", "false": "0"}.get(text, text))
    except ValueError:
        return None
    return value if np.isfinite(value) else None


@dataclass(frozen=True)
class FmuInterface:
    """One of the ways an FMU can be driven.

    Attributes:
        model_identifier: Name of the binary.
        can_be_instantiated_only_once_per_process: Whether it allows one instance at a time.
        needs_execution_tool: Whether it needs the tool that made it.
        binary: The archive member that is run.
    """

    model_identifier: str
    can_be_instantiated_only_once_per_process: bool = False
    needs_execution_tool: bool = False
    binary: str = ""

    @property
    def is_for_windows(self) -> bool:
        """Whether what is run is a library of Windows, which takes Wine here."""
        return self.binary.endswith(".dll")


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
