"""Reading a case file, and what to say of one that is wrong: one line with key, value and remedy."""

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from simulation.case_file import CaseFile, FirstMeasured, ValueWithUnit
from simulation.errors import InputError
from simulation.foreign_file import CASE, parse_toml, read_text
from simulation.foreign_text import MOST_QUOTED, quoted, shortened


def read_case_file(path: Path) -> CaseFile:
    """Read and validate a case file.

    Args:
        path: The case.toml.

    Returns:
        Its content.

    Raises:
        InputError: If the file is missing, is no TOML, or has an unknown, missing or wrong key.
    """
    text = read_text(path, CASE, if_missing="a case is a folder with a case.toml")
    content = parse_toml(text, str(path))
    try:
        return CaseFile.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{path}: {_in_one_line(error, content)}") from None


def _in_one_line(error: ValidationError, content: dict[str, Any]) -> str:
    """Return the first fault as key, value and remedy; unknown keys first, as they may be misspelt."""
    faults = error.errors(include_url=False)
    # Each branch of a union (number or table) reports a fault of its own, without the key.
    unknown = (one for one in faults if one["type"] == "unknown_key" and one["loc"][:1] != ("fixed",))
    fault = next(unknown, faults[0])
    location, kind, value = fault["loc"], fault["type"], fault["input"]
    if location[:1] == ("fixed",) and len(location) > 1:
        name = str(location[1])
        value = content["fixed"][name]
        return f"fixed.{shortened(name)} = {quoted(value)}: {_quoted(name, value) or _FIXED_REMEDY}"
    if kind == "unknown_key":
        key = _key((*location, fault["ctx"]["key"]), content)
        return f"unknown key {key} ({fault['ctx']['hint']}); remove or correct it"
    key = _key(location, content)
    if kind == "missing":
        return f"key {key} is missing; add it"
    fault_text = _PLAIN.get(kind, shortened(fault["msg"].removeprefix("Value error, "), 3 * MOST_QUOTED))
    if kind == "model_type" and location[-1:] == ("prior",):
        fault_text = _prior_remedy(value, content["parameters"][location[1]])
    if not isinstance(value, dict | list):
        key += f" = {quoted(value)}"
    return (f"{key}: " if key else "") + fault_text + ("" if "; " in fault_text else "; correct it")


_PLAIN = {
    "tuple_type": "is no pair; write two numbers, like [0, 10]",
    "too_long": "holds too much; write two numbers, like [0, 10]",
    "model_type": "is no table; write its keys as a table, like the other ones of the file",
    "dict_type": "is no table; write its keys as a table, like the other ones of the file",
    "list_type": "is no list of tables; write its name in two brackets, [[...]], over each of them",
    "string_type": "is no text; write it in quotes",
    "string_pattern_mismatch": "a name has letters, digits, - and _ only",
}
"""Messages for faults that pydantic reports in words of Python."""
_FIXED_REMEDY = (
    'give a number, true or false, a text, { value = 20.0, unit = "degC" } or { first_measured = "<output>" }'
)


def _quoted(name: str, value: object) -> str:
    """Return how to write a name with dots, which TOML takes for nested tables; "" without dots."""
    path, keys = name, {*FirstMeasured.model_fields, *ValueWithUnit.model_fields}
    while isinstance(value, dict) and len(value) == 1 and not keys & value.keys():
        ((part, value),) = value.items()
        path += f".{part}"
    return "" if path == name else f'a name with dots needs quotes; write "{shortened(path)}" = <its value>'


def _prior_remedy(value: object, parameter: dict[str, Any]) -> str:
    about = quoted(value) if isinstance(value, int | float) and not isinstance(value, bool) else "<value>"
    width = "within_factor = 1.5" if parameter.get("scale") == "log" else "within = <in its unit>"
    return f"a prior says how sure it is; write prior = {{ about = {about}, {width} }}"


def _key(location: tuple[int | str, ...], content: Any) -> str:
    words = ""
    for part in location:
        try:
            content = content[part]
        except (KeyError, IndexError, TypeError):
            content = None
        if isinstance(part, int):
            name = content.get("name") if isinstance(content, dict) else None
            words += f"[{name}]" if isinstance(name, str) else f"[{part}]"
        else:
            words += f".{part}" if words else part
    return shortened(words)
