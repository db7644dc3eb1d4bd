"""Reading a case file, and what to say of one that is wrong: one line with key, value and remedy."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from simulation.case_file import CaseFile, ExperimentTable, FirstMeasured, NamedTable, ValueWithUnit
from simulation.errors import InputError
from simulation.foreign_file import CASE, parse_toml, read_text
from simulation.foreign_text import MOST_QUOTED, quoted, shortened


@dataclass(frozen=True)
class ReadExperiment:
    """One experiment of a case file.

    Attributes:
        name: Its name, "" where the file has no [[experiments]].
        file: The case file as if it were of this experiment alone.
        is_held_out: Whether it is not calibrated.
        weight: Share of its outputs' error relative to the other experiments'. [1]
        shared: What parameters of the FMU are called among those of all experiments, where that is not their
            own name.
    """

    name: str
    file: CaseFile
    is_held_out: bool = False
    weight: float = 1.0
    shared: Mapping[str, str] = field(default_factory=dict)


M = TypeVar("M", bound=BaseModel)


class _Experiments(BaseModel):
    """What experiments change parts of, and the experiments."""

    experiments: list[ExperimentTable]
    inputs: list[NamedTable] = []
    outputs: list[NamedTable] = []
    parameters: list[NamedTable] = []
    time: dict[str, Any] = {}
    fixed: dict[str, Any] = {}


def read_experiments(path: Path) -> tuple[ReadExperiment, ...]:
    """Read and validate a case file of one or several experiments.

    Args:
        path: The case.toml.

    Raises:
        InputError: If the file is missing, is no TOML, or has an unknown, missing or wrong key.
    """
    text = read_text(path, CASE, if_missing="a case is a folder with a case.toml")
    content = parse_toml(text, str(path))
    if "experiments" not in content:
        file = _validated(CaseFile, content, str(path))
        for one in file.parameters:
            if one.per_experiment:
                raise InputError(
                    f"{path}: parameters[{one.name}].per_experiment needs [[experiments]]; drop it"
                )
        return (ReadExperiment("", file),)
    tables = _validated(_Experiments, content, str(path)).experiments
    for name, n in Counter(table.name for table in tables).items():
        if n > 1:
            raise InputError(f"{path}: experiments[{name}] is declared {n} times; keep one")
    if all(table.held_out for table in tables):
        raise InputError(f"{path}: no experiment is left to calibrate; drop held_out from one, or add one")
    names = {name for table in tables for name in table.shared.values()}
    declared = {one.get("name") for one in content.get("parameters", []) if isinstance(one, dict)}
    for table in tables:
        for target, name in table.shared.items():
            if name not in declared:
                raise InputError(
                    f"{path}: experiments[{table.name}].shared.{target} = {quoted(name)} is none of "
                    "[[parameters]]; declare it there"
                )
    read = tuple(
        ReadExperiment(
            table.name,
            _validated(
                CaseFile, _with_experiment(content, table, names), f"{path}: experiments[{table.name}]"
            ),
            table.held_out,
            table.weight,
            table.shared,
        )
        for table in tables
    )
    normalized = [one.file.outputs[0].normalize is not None for one in read]
    if len(set(normalized)) > 1:
        name = read[normalized.index(False)].name
        raise InputError(
            f"{path}: experiments[{name}] has outputs without normalize and others have it; give it to all"
        )
    return read


def _without_rivals(usual: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Return keys of an input or output without those that say what an experiment's own keys say."""
    rivals = {
        "uncertainty_column": {"uncertainty", "uncertainty_share"},
        "uncertainty": {"uncertainty_column"},
        "sum": {"column"},
        "column": {"sum", "replicates"},
        "replicates": {"column"},
        "mean_over_s": {"sum_over_s"},
        "sum_over_s": {"mean_over_s"},
    }
    gone = set[str]().union(*(rivals.get(key, set()) for key in own))
    return {key: value for key, value in usual.items() if key not in gone}


def _with_experiment(content: dict[str, Any], table: ExperimentTable, shared: set[str]) -> dict[str, Any]:
    """Return the content of a case file as if it were of one experiment alone.

    Args:
        content: The file's.
        table: The experiment.
        shared: Parameters that experiments share under names that the FMU need not know.
    """
    whole = {key: value for key, value in content.items() if key != "experiments"}
    said = table.model_dump(exclude_unset=True, exclude={"name", "held_out", "weight", "shared"})
    for key in ("inputs", "outputs"):
        usual = {one["name"]: one for one in whole.get(key, [])}
        own = [{**_without_rivals(usual.get(one["name"], {}), one), **one} for one in said.pop(key, [])]
        # Inputs all need a source; outputs are what this experiment measured.
        kept = whole.get(key, []) if key == "inputs" or not own else []
        names = {one["name"] for one in own}
        whole[key] = [one for one in kept if one["name"] not in names] + own
    time = dict(whole.get("time", {}))
    if said.get("time", {}).keys() & {"window_d", "window_s"}:
        time = {name: value for name, value in time.items() if not name.startswith("window_")}
    whole["time"] = time | said.pop("time", {})
    whole["fixed"] = whole.get("fixed", {}) | said.pop("fixed", {})
    # What an experiment knows is no parameter of it.
    tables = whole.get("parameters", [])
    by_name = {one["name"]: one for one in tables}
    whole["parameters"] = [one for one in tables if one["name"] not in {*table.fixed, *table.shared, *shared}]
    whole["parameters"] += [{**by_name[name], "name": target} for target, name in table.shared.items()]
    return whole | said


def _validated(kind: type[M], content: dict[str, Any], where: str) -> M:
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        raise InputError(f"{where}: {_in_one_line(error, content)}") from None


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
    if not isinstance(value, (dict, list)):
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
