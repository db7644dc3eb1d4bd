"""Write `docs/reference/`, and the floors of the house, from the code itself.

`python docs/make_reference.py` writes the pages; tests/end_to_end/test_reference.py compares them.
"""

import argparse
import importlib
import inspect
import json
import re
import sys
import textwrap
import types
import typing
from collections.abc import Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import grimp

FOLDER = Path(__file__).resolve().parent / "reference"
if __name__ == "__main__":
    sys.path.insert(0, str(FOLDER.parents[1]))

from simulation import case_file  # noqa: E402
from studies import comparison, profile, search_space  # noqa: E402
from studies.calibration.ledger import Ledger  # noqa: E402
from studies.cli import COMMANDS, EPILOG, build_parser, help_of  # noqa: E402
from studies.results import choice, planned, profiled, stage_results  # noqa: E402

MADE = "<!-- Written by docs/make_reference.py; change the docstrings it reads, not this page. -->\n"
PACKAGES = ("simulation", "pelsvae", "studies")
SIGNS = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
KINDS = {bool: "true or false", int: "integer", float: "number", str: "text"}
CASE_TABLES = {
    "Top of the file": case_file.CaseFile,
    "[time]": case_file.TimeTable,
    "[[inputs]]": case_file.InputTable,
    "[[outputs]]": case_file.OutputTable,
    "[[parameters]]": case_file.ParameterTable,
    "prior of a parameter": case_file.PriorTable,
    "A value of [fixed] with its unit": case_file.ValueWithUnit,
    "A measured value of [fixed]": case_file.FirstMeasured,
    "[simulation]": case_file.SimulationTable,
    "[[experiments]]": case_file.ExperimentTable,
    "[[references]]": case_file.ReferenceTable,
}
PROFILE_TABLES = {
    "Top of the file": profile.Profile,
    "[data]": profile.DataBudget,
    "[sensitivity]": profile.SensitivityBudget,
    "[tuning]": profile.TuningBudget,
    "[tuning] of an objective": profile.TrialsBudget,
    "[tuning.search]: a table per hyperparameter": search_space.SearchParameter,
    "[screening]": profile.ScreeningBudget,
    "[polish]": profile.PolishBudget,
}
DOCUMENTS = {
    "An entry of studies (status) and of sizes (best)": stage_results.TunedSize,
    "An entry of sizes (compare)": comparison.ComparedSize,
    "first and second of an entry of sizes (compare)": comparison.ComparedStudy,
    "An entry of stages (simulate)": stage_results.SimulatedSets,
    "An entry of stages (calibrate) and of calibrations (status, best)": stage_results.Calibration,
    "ledger of a calibration": Ledger,
    "An entry of outputs of a calibration": stage_results.Fit,
    "screening of a calibration": stage_results.Screened,
    "state_equations of a calibration": stage_results.EquationsFound,
    "determined_by_data of a calibration": stage_results.Determined,
    "prior of a calibration": stage_results.PriorFound,
    "An entry of parameters of a prior": stage_results.Held,
    "validation of a calibration": stage_results.Validated,
    "An entry of points of a validation": stage_results.ValidatedPoint,
    "An entry of outputs of a point": stage_results.OutputFit,
    "An entry of stages (uncertainty)": stage_results.Uncertainty,
    "An entry of parameters of an uncertainty": stage_results.Known,
    "sample of an uncertainty": stage_results.SampleFound,
    "ledger of an uncertainty": stage_results.Cost,
    "Second entry of stages (uncertainty --profiles)": profiled.Profiles,
    "An entry of parameters of profiles": profiled.Profiled,
    "An entry of stages (choose)": choice.Choice,
    "An entry of structures": choice.Structure,
    "An entry of stages (next)": planned.Planned,
    "An entry of candidates": planned.Candidate,
    "An entry of stages (predict)": stage_results.Prediction,
}


def pages() -> dict[str, str]:
    """Return the text of each page by its file name."""
    return {
        "command-line.md": "".join(_commands()),
        "case-file.md": _tables("Keys of a case file", "Every key that `case.toml` may hold.", CASE_TABLES),
        "profile.md": _tables("Keys of a profile", "Every key that a profile may hold.", PROFILE_TABLES),
        "json.md": _tables(
            "JSON documents",
            "Each command prints one JSON document with `--json`; `null` is an unknown value. The entries of "
            "its `stages` are also what `mlruns/results/<label>/<stage>.json` holds under `result`. A part "
            "that a result has not is left out. Arrays lie in `<stage>.npz` beside it.",
            DOCUMENTS,
        ),
        "../notes/floors.md": "".join(_floors()),
    }


def _floors() -> Iterator[str]:
    """Draw the floors of each package: a part stands above all that it imports."""
    graph = grimp.build_graph(*PACKAGES)
    yield f"# Floors of the house\n{MADE}\nA part imports parts of lower floors alone, as the imports say.\n"
    for package in (*PACKAGES, "studies.calibration"):
        below = {part: _below(graph, package, part) for part in graph.find_children(package)}
        floors: dict[str, int] = {}
        while len(floors) < len(below):
            ready = [part for part in below if part not in floors and below[part] <= floors.keys()]
            floors |= {part: max((floors[one] + 1 for one in below[part]), default=0) for part in ready}
        yield f"\n## {package}\n\n" + _row("floor", "part", "what it is") + _row("---", "---", "---")
        for part in sorted(floors, key=lambda one: (-floors[one], one)):
            summary = str(importlib.import_module(part).__doc__).partition("\n")[0]
            yield _row(str(floors[part]), f"`{part.removeprefix(package + '.')}`", summary)


def _below(graph: grimp.ImportGraph, package: str, part: str) -> set[str]:
    """Return the other parts of a package that a part imports."""
    within = {part, *graph.find_descendants(part)}
    imported = {name for module in within for name in graph.find_modules_directly_imported_by(module)}
    others = (name.split(".") for name in imported - within if name.startswith(f"{package}."))
    return {".".join(words[: package.count(".") + 2]) for words in others} - {part}


def _commands() -> Iterator[str]:
    yield f"# Command line\n{MADE}\nEvery command with its options, as `studies COMMAND --help` shows them.\n"
    parser = build_parser()
    (commands,) = (one for one in parser._actions if isinstance(one, argparse._SubParsersAction))
    for name in COMMANDS:
        summary, more = help_of(name)
        yield f"\n## studies {name}\n\n{summary}\n"
        yield "\n" + _row("option", "meaning") + _row("---", "---")
        for action in commands.choices[name]._actions:
            yield _row(_option(action), str(action.help).replace("%%", "%"))
        yield from _prose(more)
    yield "\n## Files and exit codes\n"
    yield from _prose(EPILOG.partition("\n\n")[2])


def _option(action: argparse.Action) -> str:
    value = action.metavar or ("|".join(map(str, action.choices)) if action.choices else "")
    typed = ", ".join(action.option_strings)
    value = str(value) if action.nargs != 0 else ""
    return f"`{typed} {value}`".replace("` ", "`").replace(" `", "`")


def _prose(text: str) -> Iterator[str]:
    """Give paragraphs as such, and what is indented as a block."""
    for part in re.split(r"\n\s*\n|(?<=:)\n(?= )", textwrap.dedent(text).strip("\n")):
        block = textwrap.dedent(part)
        if part.startswith(" ") and block.startswith("studies "):
            yield "\n```sh\n" + re.sub(r"(?<=\S) {2,}(?=\S)", "  # ", block) + "\n```\n"
        elif part.startswith(" "):
            yield f"\n```text\n{block}\n```\n"
        else:
            yield "\n" + part.replace("<", "&lt;") + "\n"


def _tables(title: str, first: str, tables: dict[str, Any]) -> str:
    text = f"# {title}\n{MADE}\n{first}\n"
    for heading, owner in tables.items():
        summary = _docstring(owner)[0]
        # What a class has from another one is described there.
        described = {k: v for one in reversed(owner.__mro__[:-1]) for k, v in _docstring(one)[1].items()}
        text += f"\n## {heading}\n\n{summary}\n\n"
        is_written = hasattr(owner, "__pydantic_fields__")
        text += _row("name", "meaning", "type", "unit", "default" * is_written)
        text += _row(*("---" for _ in range(4 + is_written)))
        for name, kind, default in _declared(owner):
            unit, meaning = _unit(name, described[name])
            text += _row(f"`{name}`", meaning, kind, unit or " ", default or " " * is_written)
    return text


def _declared(owner: Any) -> Iterator[tuple[str, str, str]]:
    """Give name, type and default of each field; results have no defaults."""
    hints = typing.get_type_hints(owner, include_extras=True)
    if (keys := getattr(owner, "__pydantic_fields__", None)) is None:
        plain = (one.name for one in fields(owner) if "ndarray" not in str(hints[one.name]))
        yield from ((name, _kind(hints[name]), "") for name in plain)
        return
    for name, key in keys.items():
        default = None if key.is_required() else key.get_default(call_default_factory=True)
        is_shown = default in (False, 0) or (default and isinstance(default, bool | int | float | str | dict))
        value = f"`{json.dumps(default)}`" if is_shown else ""
        yield key.alias or name, _kind(hints[name]), "required" if key.is_required() else value


def _kind(hint: Any, bounds: str = "") -> str:
    """Say a type in the words of TOML and JSON, with the limits of its values."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin is typing.Annotated:
        marks = [mark for field in inner[1:] for mark in (field, *getattr(field, "metadata", ()))]
        limits = {
            sign: getattr(mark, name) for mark in marks for name, sign in SIGNS.items() if hasattr(mark, name)
        }
        return _kind(inner[0], "".join(f", {sign} {limit:,}" for sign, limit in limits.items()))
    if origin in (typing.Union, types.UnionType):
        kinds = [_kind(one) for one in inner if one is not types.NoneType]
        return " or ".join(dict.fromkeys(kinds))
    if origin is typing.Literal:
        return " or ".join(f"`{json.dumps(one)}`" for one in inner)
    if origin in (list, tuple, Sequence):
        return (
            f"list of {len(inner)}: {_kind(inner[0])}"
            if inner[1:] not in ((), (...,))
            else f"list: {_kind(inner[0])}"
        )
    return KINDS.get(hint, "table") + bounds


def _docstring(owner: type) -> tuple[str, dict[str, str]]:
    """Return what a docstring says of the whole, and of each field."""
    whole, _, listed = (
        inspect.cleandoc(str(owner.__doc__)).replace("\nArgs:", "\nAttributes:").partition("\nAttributes:")
    )
    entries = re.findall(r"^    (\w+): (.*(?:\n     .*)*)", listed, flags=re.MULTILINE)
    return whole.strip(), {name: " ".join(text.split()) for name, text in entries}


def _unit(name: str, meaning: str) -> tuple[str, str]:
    """Return the unit, which ends the meaning or the name, and the meaning without it."""
    if found := re.search(r" *\[([^]]+)\]\.?$", meaning):
        return found[1], meaning[: found.start()]
    return {"_s": "s", "_d": "d"}.get(name[-2:], ""), meaning


def _row(*cells: str) -> str:
    """Return a row of a table, without the cells that it does not have."""
    texts = (" ".join(cell.split()) for cell in cells if cell)
    return "| " + " | ".join(text.replace("|", r"\|").replace("<", "&lt;") for text in texts) + " |\n"


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    for file, text in pages().items():
        (FOLDER / file).write_text(text, encoding="utf-8")
