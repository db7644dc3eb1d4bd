"""The unit in which an FMU counts its own time; everything outside this package counts seconds."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from simulation.errors import InputError
from simulation.fmi.variable import FmuVariable
from simulation.foreign_text import quoted
from simulation.units import UnitDefinition, in_si

_KNOWN = '"s", "min", "h" or "d"'


class Clock(NamedTuple):
    """What an FMU declares of its own time.

    Attributes:
        unit: Declared unit of the independent variable, "" for none.
        unit_s: How long it is, 1 s where none is declared; None where it is no unit of time, or is defined as
            something else than its name means. [s]
    """

    unit: str
    unit_s: float | None


def clock_of(variables: Mapping[str, FmuVariable], units: Mapping[str, UnitDefinition]) -> Clock:
    """Return what an FMU declares of its own time.

    Args:
        variables: Its variables.
        units: What it says of its units.
    """
    unit = next((one.unit for one in variables.values() if one.causality == "independent"), "")
    if not unit:
        return Clock("", 1.0)
    meant, defined = _seconds(unit, {}), _seconds(unit, units)
    is_doubtful = meant is not None and defined is not None and not _is_same(meant, defined)
    return Clock(unit, None if is_doubtful else defined)


def own_unit_s(
    variables: Mapping[str, FmuVariable], units: Mapping[str, UnitDefinition], said: str | None, fmu: str
) -> float:
    """Return how long one unit of an FMU's own time is. [s].

    Args:
        variables: The FMU's variables.
        units: What it says of its units.
        said: What the case says of it, None for nothing.
        fmu: Name of the FMU, for the message.

    Raises:
        InputError: If what the case says is no unit of time or contradicts the FMU, or if the case says
            nothing and the FMU counts in something else.
    """
    unit, declared_s = clock_of(variables, units)
    if said is None:
        if declared_s is None:
            raise InputError(
                f"{fmu} counts its independent variable in {quoted(unit)}, which is no clear unit of time; "
                f"say in [time] what it counts in: fmu_unit = {_KNOWN}"
            )
        return declared_s
    said_s = _seconds(said, {})
    if said_s is None:
        raise InputError(f"time.fmu_unit = {quoted(said)} is no unit of time; write {_KNOWN}")
    if unit and declared_s is not None and not _is_same(said_s, declared_s):
        raise InputError(
            f"time.fmu_unit = {quoted(said)} contradicts {fmu}, whose time counts in {quoted(unit)}; drop it"
        )
    return said_s


def _is_same(first_s: float, second_s: float) -> bool:
    # Written with some digits.
    return math.isclose(first_s, second_s, rel_tol=1e-6)


def _seconds(unit: str, units: Mapping[str, UnitDefinition]) -> float | None:
    """Return how long a unit of time is, None where it is none. [s]."""
    found = in_si(unit, units)
    if found is None or found.exponents != (("s", 1),) or found.factor <= 0 or found.offset:
        return None
    return float(found.factor)
