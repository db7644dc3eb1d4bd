"""What `studies compare` shows: what differs first, then the results with differences and ratios."""

import math
from collections.abc import Sequence
from typing import Any

from simulation.errors import InputError
from studies.console import Block, Column, Facts, Said, Table
from studies.looking.comparable import Comparable, comparables
from studies.looking.names import find_thing, kind_of
from studies.looking.project import Project
from studies.looking.verdict import verdict
from studies.report.wording import MISSING, count

COMPARABLE = ("trial", "study", "label", "calibration")
SHORT = {"validation": "val", "test": "test"}
"""Sets that judge, as the errors on them are called."""
N_DIGITS = 10
"""Digits of a digest or commit that are shown."""


def compared(project: Project, names: Sequence[str]) -> tuple[str, list[Comparable]]:
    """Return the kind of some things and the sides of their comparison.

    Raises:
        InputError: a name means nothing, or the things are not of one kind that can be compared.
    """
    things = [find_thing(project, name) for name in names]
    kinds = [kind_of(thing) for thing in things]
    if kinds[0] not in COMPARABLE:
        kinds_said = "trials, studies, labels or calibrations"
        raise InputError(f"{names[0]!r} is a {kinds[0]}; what can be compared are {kinds_said}")
    for name, kind in zip(names, kinds, strict=True):
        if kind != kinds[0]:
            raise InputError(f"{names[0]!r} is a {kinds[0]}, {name!r} a {kind}; compare things of one kind")
    named = [thing.name for thing in things]
    if len(set(named)) < len(named):
        raise InputError(f"{named[0]} is named twice; compare it with another {kinds[0]}")
    return kinds[0], comparables(project, things)


def doubts(sides: Sequence[Comparable]) -> list[str]:
    """Return why the results of the sides cannot be compared, one line each."""
    found = []
    for name in sides[0].judged_by:
        digests = [side.judged_by.get(name, "") for side in sides]
        if len(set(digests)) > 1:
            said = ", ".join(f"{digest[:8] or MISSING}" for digest in digests)
            errors = f"{SHORT[name]}/ errors" if name in SHORT else "errors"
            what = name if name in ("case", "measurement") else f"{name} set"
            found.append(f"Not comparable: another {what} ({said}); ratios of {errors} mean nothing")
    return found


def comparison_blocks(kind: str, sides: Sequence[Comparable]) -> list[Block]:
    """Return what a person sees."""
    letters = [chr(ord("A") + i) for i in range(len(sides))]
    blocks: list[Block] = [
        Facts(
            f"{len(sides)} {'studies' if kind == 'study' else kind + 's'} compared",
            [(letter, side.name) for letter, side in zip(letters, sides, strict=True)],
        )
    ]
    blocks += [Said(line, "warn") for line in doubts(sides)]
    blocks.append(_differences(letters, sides))
    blocks.append(_results(letters, sides, may_judge=not doubts(sides)))
    blocks.append(Said(verdict(kind, sides, _differing(sides)), "strong"))
    return blocks


def comparison_document(kind: str, sides: Sequence[Comparable]) -> dict[str, Any]:
    """Return what a program reads."""
    return {
        "command": "compare",
        "kind": kind,
        "names": [side.name for side in sides],
        "units": [side.unit for side in sides],
        "is_comparable": not doubts(sides),
        "doubts": doubts(sides),
        "verdict": verdict(kind, sides, _differing(sides)),
        "differs": {name: _values(name, sides) for name in _differing(sides)},
        "n_equal": len(_all_settings(sides)) - len(_differing(sides)),
        "results": {
            name: {
                "values": [_finite(side.results.get(name)) for side in sides],
                "ratios": [_ratio(sides[0].results.get(name), side.results.get(name)) for side in sides],
            }
            for name in _all_results(sides)
        },
    }


def _differences(letters: Sequence[str], sides: Sequence[Comparable]) -> Table:
    differing = _differing(sides)
    n_equal = len(_all_settings(sides)) - len(differing)
    rows = [[name, *(_setting(value) for value in _values(name, sides))] for name in differing]
    title = f"what differs ({count(n_equal, 'setting')} equal)" if rows else "all settings are equal"
    return Table(title, [Column("setting"), *map(Column, letters)], rows, is_dense=True)


def _results(letters: Sequence[str], sides: Sequence[Comparable], *, may_judge: bool) -> Table:
    unit = sides[0].unit
    columns = [Column("result"), *(Column(letter, True) for letter in letters)]
    if len(sides) == 2:
        columns += [Column("B - A", True, 1), Column("B / A", True)]
    else:
        columns += [Column(f"{letter} / A", True) for letter in letters[1:]]
    rows = []
    for name in _all_results(sides):
        values = [side.results.get(name) for side in sides]
        row: list[object] = [name, *(_number(value) for value in values)]
        first, last = values[0], values[-1]
        if len(sides) == 2:
            both = first is not None and last is not None
            row.append(_number(last - first) if both and first is not None and last is not None else MISSING)
        is_error = may_judge and ("/" in name or "MSE" in name or name == "gap")
        row += [_told_ratio(_ratio(first, value), is_error=is_error) for value in values[1:]]
        rows.append(row)
    has_outputs = any("/mae_" in name for name in _all_results(sides))
    alone = "; mae_... in that output's unit" if has_outputs else ""
    behind = f" (errors in {unit}{alone})" if unit else ""
    return Table(f"results{behind}", columns, rows, is_dense=True)


def _all_settings(sides: Sequence[Comparable]) -> list[str]:
    return list(dict.fromkeys(name for side in sides for name in side.settings))


def _all_results(sides: Sequence[Comparable]) -> list[str]:
    return list(dict.fromkeys(name for side in sides for name in side.results))


def _differing(sides: Sequence[Comparable]) -> list[str]:
    found = []
    for name in _all_settings(sides):
        values = _values(name, sides)
        if any(value != values[0] for value in values[1:]):
            found.append(name)
    return found


def _values(name: str, sides: Sequence[Comparable]) -> list[Any]:
    return [side.settings.get(name) for side in sides]


def _setting(value: Any) -> str:
    if value is None:
        return MISSING
    if isinstance(value, float):
        return f"{value:.6g}"
    text = str(value)
    is_digest = len(text) >= 40 and all(sign in "0123456789abcdef" for sign in text)
    return text[:N_DIGITS] if is_digest else text


def _number(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return MISSING
    return str(value) if isinstance(value, int) else f"{value:.4g}"


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _ratio(first: float | None, other: float | None) -> float | None:
    if first is None or other is None or not first or not math.isfinite(first) or not math.isfinite(other):
        return None
    return other / first


def _told_ratio(ratio: float | None, *, is_error: bool) -> Said:
    if ratio is None:
        return Said(MISSING)
    tone = "good" if is_error and ratio < 0.995 else "warn" if is_error and ratio > 1.005 else ""
    return Said(f"{ratio:.3f}", tone)  # type: ignore[arg-type]
