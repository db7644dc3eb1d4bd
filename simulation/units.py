"""Units as text: when two spellings mean the same, and the one conversion made (degC and K)."""

import re
from collections import Counter

from simulation.errors import InputError

_ZERO_CELSIUS_K = 273.15
_CELSIUS = "degC"
_SPELLINGS = {"°C": _CELSIUS, "℃": _CELSIUS, "·": ".", "*": ".", "²": "2", "³": "3", "^": ""}
_TOKEN = re.compile(r"(?P<sign>[./()])|(?P<name>[^\W\d_]+|%)(?P<power>-?\d+)?|1")


def offset_between(declared: str, model: str | None, where: str) -> float:
    """Return what to add to a value in the declared unit to get it in the model's unit.

    Args:
        declared: Unit in the case file.
        model: Unit in the model, None or "" when it declares none (any unit is taken then).
        where: What the unit belongs to, for the message.

    Returns:
        0 for the same unit, 273.15 from degC to K, -273.15 from K to degC.

    Raises:
        InputError: If the units contradict each other.
    """
    if not model or _normal(declared) == _normal(model):
        return 0.0
    if (_normal(declared), _normal(model)) == (_normal(_CELSIUS), _normal("K")):
        return _ZERO_CELSIUS_K
    if (_normal(declared), _normal(model)) == (_normal("K"), _normal(_CELSIUS)):
        return -_ZERO_CELSIUS_K
    raise InputError(
        f'{where}: unit = "{declared}" contradicts the FMU\'s "{model}"; '
        f'give the values in "{model}" (only degC and K are converted)'
    )


def same_unit(first: str, second: str | None) -> bool:
    """Tell whether two spellings mean the same unit; no unit matches any.

    Args:
        first: A unit.
        second: Another unit, or None or "" for none declared.

    Returns:
        Whether they are the same.
    """
    return not second or _normal(first) == _normal(second)


def _normal(unit: str) -> tuple[tuple[str, int], ...] | str:
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
        match token["sign"]:
            case "/":
                turn = -1
            case "(":
                signs.append(signs[-1] * turn)
                turn = 1
            case ")" if len(signs) > 1:
                signs.pop()
                turn = 1
            case ")":
                return text
            case ".":
                turn = 1
            case None:
                if token["name"]:
                    exponents[token["name"]] += signs[-1] * turn * int(token["power"] or 1)
    return tuple(sorted((name, power) for name, power in exponents.items() if power))
