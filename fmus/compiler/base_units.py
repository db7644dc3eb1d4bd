"""Units in Modelica's notation, as the powers of the SI base units that FMI asks for."""

import math
import re
from dataclasses import dataclass, field

from fmus.compiler.compile_error import CompileError


@dataclass(frozen=True)
class BaseUnit:
    """Product of SI base units: ``value in SI = factor * value + offset``.

    Attributes:
        powers: Exponent of each base unit, such as ``{"kg": 1, "m": 2, "s": -3}``; without zeros.
        factor: Multiple of the SI unit.
        offset: Zero of the unit's scale in the SI unit.
    """

    powers: dict[str, int] = field(default_factory=dict)
    factor: float = 1.0
    offset: float = 0.0


_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_DEFINED = {
    "g": (1e-3, "kg"), "min": (60.0, "s"), "h": (3600.0, "s"), "d": (86400.0, "s"), "l": (1e-3, "m3"),
    "deg": (math.pi / 180.0, "rad"), "Hz": (1.0, "s-1"), "N": (1.0, "kg.m.s-2"), "Pa": (1.0, "kg.m-1.s-2"),
    "J": (1.0, "kg.m2.s-2"), "kJ": (1e3, "kg.m2.s-2"), "W": (1.0, "kg.m2.s-3"), "kW": (1e3, "kg.m2.s-3"),
    "V": (1.0, "kg.m2.s-3.A-1"), "degC": (1.0, "K"),
}  # fmt: skip
_FACTOR = re.compile(r"([A-Za-z]+|1)(-?\d+)?")


def parse_unit(unit: str) -> BaseUnit:
    """Resolve a unit such as ``W/(m2.K)`` into base units.

    Args:
        unit: Modelica unit: factors joined by points, at most one slash, exponents as digits.

    Returns:
        The base unit; an offset only for a bare unit such as ``degC``.

    Raises:
        CompileError: If the unit is unknown or malformed.
    """
    if unit == "degC":
        return BaseUnit({"K": 1}, 1.0, 273.15)
    over, slash, under = unit.partition("/")
    if under.startswith("(") and under.endswith(")"):
        under = under[1:-1]
    elif "." in under:
        raise CompileError(f"unit {unit!r}: put the divisor in brackets, as in W/(m2.K)")
    powers: dict[str, int] = {}
    factor = 1.0
    for sign, part in ((1, over), (-1, under)):
        if not part and not (sign < 0 and not slash):
            raise CompileError(f"unit {unit!r}: nothing on one side of the slash")
        for text in part.split(".") if part else []:
            match = _FACTOR.fullmatch(text)
            if match is None or match[1] not in ("1", *_BASE, *_DEFINED):
                raise CompileError(
                    f"unit {unit!r}: {text!r} is not known; add it to fmus/compiler/base_units.py"
                )
            exponent = sign * int(match[2] or 1)
            size, others = _DEFINED.get(match[1], (1.0, ""))
            factor *= size**exponent
            own = {match[1]: 1} if match[1] in _BASE else {}
            for name, power in (parse_unit(others).powers if others else own).items():
                powers[name] = powers.get(name, 0) + power * exponent
    return BaseUnit({name: power for name, power in powers.items() if power}, factor)


def derivative_unit(unit: str) -> str:
    """Give the unit of a time derivative, such as ``K/s`` for ``K``."""
    over, _, under = unit.partition("/")
    if not under:
        return f"{over}/s"
    return f"{over}/({under.strip('()')}.s)"
