"""Units as text: what they are in SI, by the FMU's own definitions first, and the conversion between two."""

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

from simulation.errors import InputError

BASE_UNITS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

_SPELLINGS = {"°C": "degC", "℃": "degC", "°": "deg", "·": ".", "*": ".", "²": "2", "³": "3", "^": ""}
_TOKEN = re.compile(r"(?P<sign>[./()])|(?P<name>[^\W\d_]+|%)(?P<power>-?\d{1,2})?|1")
_MOST_POWER = 100  # of a number with thousands of digits no unit is made
_RADIAN = Fraction(math.pi) / 180

# Times in full, as programs that are no physics tools write them.
_TIMES = {
    f"{name}{plural}": size
    for names, size in (
        (("sec", "second"), "1 s"), (("minute",), "60 s"), (("hr", "hour"), "3600 s"), (("day",), "86400 s"),
    )
    for name in names
    for plural in ("", "s")
}  # fmt: skip

# Units by name, in others.
_DEFINED = {
    "%": "0.01 1", "ppm": "1e-6 1", "ha": "10000 m2", "l": "0.001 m3", "L": "0.001 m3", "g": "0.001 kg",
    "t": "1000 kg", "min": "60 s", "h": "3600 s", "d": "86400 s", **_TIMES, "Hz": "1 s-1", "lm": "1 cd",
    "lx": "1 cd.m-2", "N": "1 kg.m.s-2", "Pa": "1 N.m-2", "bar": "1e5 Pa", "atm": "101325 Pa", "J": "1 N.m",
    "Wh": "3600 J", "cal": "4.184 J", "W": "1 J.s-1", "VA": "1 W", "var": "1 W", "Ah": "3600 A.s",
    "V": "1 W.A-1", "Ohm": "1 V.A-1", "S": "1 A.V-1", "F": "1 A.s.V-1", "H": "1 V.s.A-1", "T": "1 V.s.m-2",
}  # fmt: skip
_NO_PREFIX = {"%", "ppm", "kg", "rad", "cd", "ha", "min", "h", "d", "atm", *_TIMES}
_PREFIXES = {
    "G": "1e9", "M": "1e6", "k": "1e3", "h": "100", "d": "0.1", "c": "0.01", "m": "0.001", "u": "1e-6",
    "µ": "1e-6", "μ": "1e-6", "n": "1e-9",
}  # fmt: skip

Exponents = tuple[tuple[str, int], ...]


@dataclass(frozen=True)
class Unit:
    """A unit in SI base units: value in SI = factor * value + offset.

    Attributes:
        factor: Size of the unit. [SI]
        offset: Where its zero lies. [SI]
        exponents: Powers of kg, m, s, A, K, mol, cd and rad, sorted by name.
    """

    factor: Fraction
    offset: Fraction
    exponents: Exponents

    @classmethod
    def of(cls, powers: Mapping[str, int], factor: float, offset: float) -> "Unit":
        """Take what a model description says; its decimal numbers are meant as they are written."""
        return cls(Fraction(str(factor)), Fraction(str(offset)), _sorted(powers))


@dataclass(frozen=True)
class UnitDefinition:
    """What an FMU says of one of its units.

    Attributes:
        base: The unit in SI, None where the FMU says nothing of it.
        displayed: Units that stand for it in a display, by name: factor and offset from the unit to them.
    """

    base: Unit | None = None
    displayed: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Conversion:
    """From a declared unit to the model's: value in the model = factor * value + offset."""

    factor: float = 1.0
    offset: float = 0.0

    @property
    def inverse(self) -> "Conversion":
        """From the model's unit to the declared one."""
        return Conversion(1.0 / self.factor, -self.offset / self.factor)


_DEGREES = {
    "degC": Unit(Fraction(1), Fraction("273.15"), (("K", 1),)),
    "degF": Unit(Fraction(5, 9), Fraction("459.67") * Fraction(5, 9), (("K", 1),)),
    "deg": Unit(_RADIAN, Fraction(0), (("rad", 1),)),
    "rev": Unit(_RADIAN * 360, Fraction(0), (("rad", 1),)),
    "rpm": Unit(_RADIAN * 6, Fraction(0), (("rad", 1), ("s", -1))),
}


def conversion(
    declared: str,
    model: str | None,
    where: str,
    *,
    definitions: Mapping[str, UnitDefinition] | None = None,
    is_difference: bool = False,
) -> Conversion:
    """Return the conversion from a declared unit to the model's.

    The FMU's own definitions of its units go before what is known of their names.

    Args:
        declared: Unit in the case file.
        model: Unit in the model, None or "" when it declares none (any unit is taken then, unconverted).
        where: What the unit belongs to, for the message.
        definitions: The FMU's units by name.
        is_difference: Whether the values are differences: 1 degC is 1 K then.

    Returns:
        The conversion; the identity for two spellings of one unit.

    Raises:
        InputError: If the units contradict each other, or cannot be compared.
    """
    if not model or _normal(declared) == _normal(model):
        return Conversion()
    defined = (definitions or {}).get(model, UnitDefinition())
    _check_definition(model, defined, where)
    theirs = defined.base or in_si(model)
    shown = next((pair for name, pair in defined.displayed.items() if _same(name, declared)), None)
    if shown is not None:
        factor = 1 / Fraction(str(shown[0]))
        offset = -Fraction(str(shown[1])) * factor
        meant = in_si(declared)
        if meant is not None and theirs is not None:
            size, zero = factor * theirs.factor, offset * theirs.factor + theirs.offset
            if not _agree(meant, Unit(size, zero, theirs.exponents), is_difference=is_difference):
                raise InputError(
                    f'{where}: the FMU defines "{declared}", a display unit of its "{model}", as something '
                    f'else than "{declared}" means; give the values in "{model}", and check them'
                )
    else:
        mine = in_si(declared, definitions)
        if mine is None or theirs is None or mine.exponents != theirs.exponents:
            known = "contradicts" if mine is not None else "is not known, and is not"
            raise InputError(
                f'{where}: unit = "{declared}" {known} the FMU\'s "{model}"; '
                f'give the values in "{model}" or in a unit of the same kind'
            )
        factor, offset = mine.factor / theirs.factor, (mine.offset - theirs.offset) / theirs.factor
    try:
        return Conversion(float(factor), 0.0 if is_difference else float(offset))
    except OverflowError:
        raise InputError(
            f'{where}: no number holds what 1 "{declared}" is in "{model}"; correct the unit'
        ) from None


def _check_definition(name: str, defined: UnitDefinition, where: str) -> None:
    """Refuse to convert to a unit whose definition in the FMU is not what its name means."""
    meant = in_si(name)
    if meant is not None and defined.base is not None and not _agree(meant, defined.base):
        raise InputError(
            f'{where}: the FMU defines its unit "{name}" as something else than "{name}" means; '
            f'give the values in "{name}", which converts nothing, and check them'
        )


def _agree(first: Unit, second: Unit, *, is_difference: bool = False) -> bool:
    """Return whether two units are the same, written with some digits; some tools leave the angle out."""
    powers = [[power for power in unit.exponents if power[0] != "rad"] for unit in (first, second)]
    return (
        powers[0] == powers[1]
        and math.isclose(first.factor, second.factor, rel_tol=1e-6)
        # Only temperatures have zeros of their own.
        and (is_difference or math.isclose(first.offset, second.offset, rel_tol=1e-6, abs_tol=1e-4))
    )


def in_si(text: str, definitions: Mapping[str, UnitDefinition] | None = None) -> Unit | None:
    """Return a unit in SI base units.

    A degree Celsius inside a product is a difference of temperatures.

    Args:
        text: The unit, e.g. "W/(m2.K)", "kWh", "l/s".
        definitions: The FMU's units by name, which go first.

    Returns:
        The unit, None where it is not known.
    """
    for name, definition in (definitions or {}).items():
        if definition.base is not None and _same(name, text):
            return definition.base
    powers = _normal(text)
    if isinstance(powers, str):
        return None
    if len(powers) == 1 and powers[0][1] == 1:
        return _named(powers[0][0])
    factor, exponents = Fraction(1), Counter[str]()
    for name, power in powers:
        unit = _named(name)
        if unit is None:
            return None
        factor *= unit.factor**power
        for base, exponent in unit.exponents:
            exponents[base] += exponent * power
    return Unit(factor, Fraction(0), _sorted(exponents))


def _named(name: str) -> Unit | None:
    unit = _DEGREES.get(name) or _without_prefix(name)
    prefix, rest = name[:1], name[1:]
    if unit is None and prefix in _PREFIXES and rest not in _NO_PREFIX and (unit := _without_prefix(rest)):
        unit = replace(unit, factor=unit.factor * Fraction(_PREFIXES[prefix]))
    return unit


def _without_prefix(name: str) -> Unit | None:
    if name in BASE_UNITS:
        return Unit(Fraction(1), Fraction(0), ((name, 1),))
    size, _, others = _DEFINED.get(name, "").partition(" ")
    unit = in_si(others) if size else None
    return unit and replace(unit, factor=unit.factor * Fraction(size))


def _same(first: str, second: str) -> bool:
    return _normal(first) == _normal(second)


def _sorted(exponents: Mapping[str, int]) -> Exponents:
    return tuple(sorted((name, power) for name, power in exponents.items() if power))


def _normal(unit: str) -> Exponents | str:
    """Return the exponents of a unit's factors, or its plain text where it is no product of powers."""
    text = unit.strip()
    for spelling, normal in _SPELLINGS.items():
        text = text.replace(spelling, normal)
    text = re.sub(r"\s+", ".", text)
    exponents: Counter[str] = Counter()
    # Each open bracket remembers the sign its content is raised with; a slash turns the next factor only.
    signs, turn, position = [1], 1, 0
    while position < len(text):
        token = _TOKEN.match(text, position)
        if token is None:
            return text
        position = token.end()
        if token["name"]:
            exponents[token["name"]] += signs[-1] * turn * int(token["power"] or 1)
        elif token["sign"] == "(":
            signs.append(signs[-1] * turn)
        elif token["sign"] == ")":
            signs.pop()
            if not signs:
                return text
        if token["sign"]:
            turn = -1 if token["sign"] == "/" else 1
    is_unit = len(signs) == 1 and all(abs(power) < _MOST_POWER for power in exponents.values())
    return _sorted(exponents) if is_unit else text
