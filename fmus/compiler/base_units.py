"""Units in Modelica's notation, as the powers of the SI base units that FMI asks for."""

import re
from collections import Counter

from fmus.compiler.compile_error import CompileError

_BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")
_DEFINED = {
    "N": "kg.m.s-2", "Pa": "kg.m-1.s-2", "J": "kg.m2.s-2", "W": "kg.m2.s-3", "V": "kg.m2.s-3.A-1",
    "degC": "K", "1": "",
}  # fmt: skip
_FACTOR = re.compile(r"([A-Za-z]+|1)(-?\d+)?")


def base_powers(unit: str) -> dict[str, int]:
    """Resolve a unit such as ``W/(m2.K)`` into powers of base units, such as ``{"kg": 1, "s": -3, "K": -1}``.

    Args:
        unit: Modelica unit: factors joined by points, at most one slash, exponents as digits; a multiple of
            an SI unit is none.

    Raises:
        CompileError: If the unit is unknown or malformed.
    """
    over, _, under = unit.partition("/")
    powers = Counter[str]()
    for sign, part in ((1, over), (-1, under.strip("()"))):
        for text in filter(None, part.split(".")):
            match = _FACTOR.fullmatch(text)
            if match is None or match[1] not in (*_BASE, *_DEFINED):
                raise CompileError(
                    f"unit {unit!r}: {text!r} is not known; add it to fmus/compiler/base_units.py"
                )
            name, exponent = match[1], sign * int(match[2] or 1)
            own = {name: 1} if name in _BASE else base_powers(_DEFINED[name])
            for base, power in own.items():
                powers[base] += power * exponent
    return {name: power for name, power in powers.items() if power}
