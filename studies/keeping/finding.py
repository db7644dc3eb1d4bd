"""What an examination of the stores finds: what is wrong, where, and the remedy."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from studies.console import Column, Console, Said, Table, Tone
from studies.report.wording import count

Level = Literal["ok", "note", "bad"]
"""Sound, nothing wrong but worth knowing, or a finding."""

_TONES: dict[Level, Tone] = {"ok": "good", "note": "dim", "bad": "bad"}
N_NAMED = 4
"""Things that a finding names at most."""


@dataclass(frozen=True)
class StoreFinding:
    """One thing that was looked at in the stores.

    Args:
        store: which store it concerns, for example "Optuna".
        level: ok, note or bad.
        where: study, file or table.
        found: what was found there.
        remedy: what to do; empty when all is well.
        repair: puts it right and returns what it did; None where only a person can, or `--upgrade` does.
    """

    store: str
    level: Level
    where: str
    found: str
    remedy: str = ""
    repair: Callable[[], str] | None = field(default=None, compare=False, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as JSON values."""
        return {
            "store": self.store,
            "level": self.level,
            "where": self.where,
            "found": self.found,
            "remedy": self.remedy,
            "repairable": self.repair is not None,
        }


def ok(store: str, where: str, found: str) -> StoreFinding:
    """Return that something is sound."""
    return StoreFinding(store, "ok", where, found)


def listed(names: Sequence[object]) -> str:
    """Return names in a row, the first few where there are many."""
    more = f" and {len(names) - N_NAMED} more" if len(names) > N_NAMED else ""
    return ", ".join(map(str, names[:N_NAMED])) + more


def is_sound(findings: Sequence[StoreFinding]) -> bool:
    """Return whether nothing is wrong."""
    return all(finding.level != "bad" for finding in findings)


def show_findings(console: Console, title: str, findings: Sequence[StoreFinding]) -> None:
    """Print the findings as a table, what is wrong last, and what they come to."""
    ordered = sorted(findings, key=lambda finding: ("ok", "note", "bad").index(finding.level))
    rows = [
        [
            finding.store,
            Said(finding.level, _TONES[finding.level]),
            finding.where,
            finding.found,
            finding.remedy,
        ]
        for finding in ordered
    ]
    columns = [Column("store"), Column("result"), Column("where"), Column("found"), Column("what to do")]
    console.show([Table(title, columns, rows)])
    n_bad = sum(finding.level == "bad" for finding in findings)
    if not n_bad:
        console.result("The stores are sound.")
        return
    n_safe = sum(finding.level == "bad" and finding.repair is not None for finding in findings)
    word = f"; `studies doctor --repair` puts {n_safe} of them right" if n_safe else ""
    console.result(f"{count(n_bad, 'finding')}{word}.")
