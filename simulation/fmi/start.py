"""The start of every row: parameters of any kind are set, and the FMU initializes itself."""

import ctypes
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.fmi.inputs import Inputs
from simulation.fmi.instance import WARNING, FmuInstance
from simulation.fmi.kinds import SETTERS
from simulation.fmi.plan import RunPlan
from simulation.fmi.variable import REAL_KINDS, FmuVariable

_Value = float | int | bool | str


class Start:
    """Sets the parameters of a row and initializes the instance; the same for all interfaces and versions."""

    def __init__(self, instance: FmuInstance, plan: RunPlan, where: str) -> None:
        """Sort the parameters by their kinds and check the fixed ones.

        Args:
            instance: The FMU.
            plan: What is to be set.
            where: The FMU's file, for messages.

        Raises:
            InputError: If a fixed value does not fit its variable.
        """
        self._instance = instance
        self._plan = plan
        structural = [one for one in plan.fixed if one[0].causality == "structuralParameter"]
        others = [one for one in plan.fixed if one[0].causality != "structuralParameter"]
        self._structural = [
            _fixed_setting(instance, setter, variables, where)
            for setter, variables in _by_setter(instance, structural)
        ]
        self._fixed = [
            _fixed_setting(instance, setter, variables, where)
            for setter, variables in _by_setter(instance, others)
        ]
        self.parameters: Final = [
            _Calibrated(instance, kind, plan.calibrated)
            for kind in dict.fromkeys(variable.kind for variable in plan.calibrated)
        ]
        self.inputs: Final = Inputs(instance, plan, where)

    def begin(self, values: FloatArray) -> str:
        """Take the instance from "as if just instantiated" to the first step.

        Args:
            values: The calibrated parameters. Shape (p,). [FMU's units]

        Returns:
            Why it failed, in one line; "" when it did not.
        """
        instance, plan = self._instance, self._plan
        start, stop = float(plan.edges[0]), float(plan.edges[-1])
        asked, tolerance = plan.tolerance is not None, plan.tolerance or 0.0
        if self._structural and (failure := self._configure(start)):
            return failure
        experiment = (asked, tolerance, start, True, stop)
        if instance.prefix == "fmi2":
            status = instance.call("SetupExperiment", *experiment)
            if status > WARNING:
                return instance.failure("SetupExperiment", status, start)
        for group in self._fixed:
            if failure := group.set(start):
                return failure
        if failure := self.set_parameters(values, start):
            return failure
        status = instance.call("EnterInitializationMode", *(experiment if instance.prefix == "fmi3" else ()))
        if status > WARNING:
            return instance.failure("EnterInitializationMode", status, start)
        # Inputs of the first step are set here too: initial values may depend on them.
        if failure := self.inputs.set_first(start):
            return failure
        status = instance.call("ExitInitializationMode")
        if status > WARNING:
            return instance.failure("ExitInitializationMode", status, start)
        instance.initialized()
        return ""

    def set_parameters(self, values: FloatArray, time: float) -> str:
        """Set the calibrated parameters.

        Args:
            values: Their values. Shape (p,). [FMU's units]
            time: Simulated time, for the message. [s]

        Returns:
            Why it failed, in one line; "" when it did not.
        """
        for group in self.parameters:
            if failure := group.set(values, time):
                return failure
        return ""

    def _configure(self, time: float) -> str:
        """Set the structural parameters, which have a mode of their own."""
        for name in ("EnterConfigurationMode", "", "ExitConfigurationMode"):
            if name:
                status = self._instance.call(name)
                if status > WARNING:
                    return self._instance.failure(name, status, time)
            else:
                for group in self._structural:
                    if failure := group.set(time):
                        return failure
        return ""


class _Setting:
    """Some variables that one function sets, and the buffer that their values are in."""

    def __init__(
        self, instance: FmuInstance, function: str, variables: Sequence[FmuVariable], values: Any
    ) -> None:
        self._instance = instance
        self._function = function
        self._references = np.array([variable.reference for variable in variables], dtype=np.uint32)
        self.values = values
        address = values.ctypes.data if isinstance(values, np.ndarray) else ctypes.addressof(values)
        n = len(variables)
        # Addresses are reckoned once: a row may take no longer than a few of these calls.
        self._arguments: tuple[int, ...] = (self._references.ctypes.data, n, address)
        if instance.prefix == "fmi3":
            self._arguments += (n,)

    def set(self, time: float) -> str:
        status = self._instance.call(self._function, *self._arguments)
        return self._instance.failure(self._function, status, time) if status > WARNING else ""


class _Calibrated:
    """The calibrated parameters of one kind; a row's values are copied into a buffer of its C type."""

    def __init__(self, instance: FmuInstance, kind: str, calibrated: Sequence[FmuVariable]) -> None:
        function, dtype = SETTERS[instance.prefix][kind]
        self._columns = np.array([i for i, one in enumerate(calibrated) if one.kind == kind], dtype=np.intp)
        self._setting = _Setting(
            instance, function, [calibrated[i] for i in self._columns], np.zeros(len(self._columns), dtype)
        )

    def set(self, values: FloatArray, time: float) -> str:
        self._setting.values[:] = values[self._columns]
        return self._setting.set(time)


def _fixed_setting(
    instance: FmuInstance, setter: str, fixed: Sequence[tuple[FmuVariable, _Value]], where: str
) -> _Setting:
    """Check the fixed parameters that one function sets."""
    dtype = SETTERS[instance.prefix][fixed[0][0].kind][1]
    checked = [_checked(variable, value, dtype, where) for variable, value in fixed]
    values: Any = (
        (ctypes.c_char_p * len(checked))(*(str(value).encode() for value in checked))
        if dtype is None
        else np.array(checked, dtype=dtype)
    )
    return _Setting(instance, setter, [variable for variable, _ in fixed], values)


def _by_setter(
    instance: FmuInstance, fixed: Sequence[tuple[FmuVariable, _Value]]
) -> list[tuple[str, list[tuple[FmuVariable, _Value]]]]:
    groups: dict[str, list[tuple[FmuVariable, _Value]]] = {}
    for variable, value in fixed:
        groups.setdefault(SETTERS[instance.prefix][variable.kind][0], []).append((variable, value))
    return list(groups.items())


def _checked(variable: FmuVariable, value: _Value, dtype: Any, where: str) -> _Value:
    """Return the value as its variable wants it."""
    kind, wrong = variable.kind, f"{where}: fixed.{variable.name} = {value!r}"
    if kind == "String":
        if not isinstance(value, str):
            raise InputError(f"{wrong} is no text, and the FMU's {variable.name} is; put it in quotes")
        return value
    if kind == "Boolean":
        if not isinstance(value, bool):
            raise InputError(f"{wrong}: the FMU's {variable.name} is true or false; write one of the two")
        return value
    if kind == "Enumeration" and isinstance(value, str):
        if value not in variable.items:
            choice = ", ".join(variable.items) or "its numbers"
            raise InputError(f"{wrong} is none of its values; choose one of: {choice}")
        return variable.items[value]
    if isinstance(value, str | bool):
        raise InputError(f"{wrong} is no number, and the FMU's {variable.name} is a {kind}; give a number")
    if kind in REAL_KINDS:
        return float(value)
    limits = np.iinfo(dtype)
    if value != int(value) or not limits.min <= value <= limits.max:
        raise InputError(
            f"{wrong} is no {kind}; give a whole number from {int(limits.min)} to {int(limits.max)}"
        )
    return int(value)
