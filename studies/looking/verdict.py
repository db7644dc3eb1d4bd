"""The sentence under a comparison: which side is better at what, and whether that may be chance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from studies.looking.comparable import Comparable
from studies.report.wording import listed

ERRORS = {
    "val/mae": ("validation error", ("case", "validation")),
    "test/mae": ("test error", ("case", "test")),
    "final MSE": ("MSE", ("case", "measurement")),
    "calls (paper)": ("model calls", ("case", "measurement")),
}
"""Results that decide, as a sentence calls them, and what must be the same for them to be compared."""
SAME = 5e-4
"""Results that differ by a smaller part are called equal."""
FOLLOWS_SEED = ("seed", "train digest", "state")
"""Settings that another seed alone makes differ; so does what begins with "best: "."""


@dataclass(frozen=True)
class _Win:
    side: int | None
    said: str


def verdict(kind: str, sides: Sequence[Comparable], differing: Sequence[str]) -> str:
    """Say in one line which side is better at what.

    Args:
        kind: what is compared.
        sides: the sides.
        differing: names of the settings that differ.
    """
    wins = _of_sizes(sides) if kind == "label" else _of_results(sides)
    if not wins:
        return "No verdict: nothing was judged on the same data on all sides."
    phrases: list[str] = []
    for side, letter in enumerate(chr(ord("A") + i) for i in range(len(sides))):
        won = [win.said for win in wins if win.side == side]
        if won:
            phrases.append(
                f"{letter} is better in {listed(won)}" if not phrases else f"{letter} in {listed(won)}"
            )
    equal = [win.said for win in wins if win.side is None]
    if equal:
        phrases.append(f"equal: {listed(equal)}" if phrases else f"Equal in {listed(equal)}")
    return "; ".join(phrases) + "." + (_chance(differing) if len(equal) < len(wins) else "")


def _of_results(sides: Sequence[Comparable]) -> list[_Win]:
    found = []
    for name, (said, needs) in ERRORS.items():
        values = [side.results.get(name) for side in sides]
        if _is_judged_alike(sides, needs) and None not in values:
            found.append(_won(said, [float(value) for value in values if value is not None]))
    return found


def _won(said: str, values: Sequence[float]) -> _Win:
    best, second = sorted(values)[:2]
    part = 1.0 - best / second if second else 0.0
    if part < SAME:
        return _Win(None, said)
    behind = "fewer" if said == "model calls" else "lower"
    than = "" if len(values) == 2 else " than the next"
    return _Win(values.index(best), f"{said} ({100.0 * part:.1f} % {behind}{than})")


def _of_sizes(sides: Sequence[Comparable]) -> list[_Win]:
    """Count at how many sizes each label has the least error."""
    counted: dict[tuple[str, str], list[str]] = {}
    for name in sides[0].results:
        _, _, result = name.partition(": ")
        if all(name in side.results for side in sides):
            counted.setdefault((result, "calibrations" if result == "MSE" else "sizes"), []).append(name)
    found = []
    for (result, of), names in counted.items():
        said, needs = ERRORS.get(result, ERRORS["final MSE"])
        if result == "calls" or not _is_judged_alike(sides, needs):
            continue
        least = [_won("", [float(side.results[name]) for side in sides]).side for name in names]
        won: Mapping[int, int] = {side: least.count(side) for side in range(len(sides)) if side in least}
        found += [_Win(side, f"{said} ({n} of {len(names)} {of})") for side, n in won.items()]
        if not won:
            found.append(_Win(None, f"{said} ({len(names)} {of})"))
    return found


def _is_judged_alike(sides: Sequence[Comparable], needs: Sequence[str]) -> bool:
    return all(
        len({side.judged_by.get(need, "") for side in sides}) == 1
        for need in needs
        if any(need in side.judged_by for side in sides)
    )


def _chance(differing: Sequence[str]) -> str:
    others = [name for name in differing if name not in FOLLOWS_SEED and not name.startswith("best: ")]
    if "seed" in differing and not others:
        return " Only the seed differs: so much is chance."
    return " One seed each: the same with other seeds (--seed) tells how much of it is chance."
