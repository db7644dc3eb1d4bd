"""What `studies check` finds: one line each, with what to do; the words are those of findings.toml."""

import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

from studies.words.console import Column, Console

Level = Literal["ok", "warn", "fail"]
LONGEST = 4
"""Names in one line."""
STOPPED = "was stopped"
"""What the reason of a row says that ran into a time-out."""
MORE_TIME = "say how long one simulation may take: [simulation] timeout_s; or wait: --thorough"
"""What to do about it."""


@dataclass(frozen=True)
class Finding:
    """What was examined, and the result.

    Args:
        what: what was examined.
        level: ok, warn (the study can go on) or fail (it cannot).
        found: what was found, with numbers.
        remedy: what to do; empty when all is well.
        key: its kind, by which programs know it; empty in results of earlier versions.
    """

    what: str
    level: Level
    found: str
    remedy: str = ""
    key: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """All findings about a case.

    Args:
        findings: one per examination.
        simulation_s: time of one simulation. [s]
    """

    findings: tuple[Finding, ...]
    simulation_s: float

    @property
    def is_sound(self) -> bool:
        """Whether nothing failed."""
        return all(finding.level != "fail" for finding in self.findings)


@cache
def _words() -> dict[str, dict[str, str]]:
    return tomllib.loads(Path(__file__).with_name("findings.toml").read_text(encoding="utf-8"))


def finding(key: str, level: Level = "warn", **values: Any) -> Finding:
    """Return a finding in the words of its key, which these values complete."""
    words = {name: text.format(**values) for name, text in _words()[key].items()}
    return Finding(words["what"], level, words["found"], "" if level == "ok" else words["remedy"], key)


def named(key: str, names: Sequence[str], separator: str = ", ", **values: Any) -> Iterator[Finding]:
    """Give a finding to look at where there are names: a few of them, and how many more there are."""
    if names:
        more = f" and {len(names) - LONGEST} more" if len(names) > LONGEST else ""
        yield finding(key, names=separator.join(names[:LONGEST]) + more, **values)


def say_warnings(console: Console, diagnosis: Diagnosis) -> None:
    """Say in one line each what a study may go on with and its user should know."""
    for one in diagnosis.findings:
        if one.level == "warn":
            console.say(f"check: {one.what}: {one.found}; {one.remedy}")


def show_diagnosis(console: Console, label: str, diagnosis: Diagnosis) -> None:
    """Print the findings as a table, and what they come to."""
    console.table(
        f"{label}: findings",
        [Column("examined"), Column("result"), Column("found"), Column("what to do")],
        [[one.what, one.level, one.found, one.remedy] for one in diagnosis.findings],
    )
    levels = [one.level for one in diagnosis.findings]
    words = f"{levels.count('fail')} failed, {levels.count('warn')} to look at, {levels.count('ok')} good"
    console.result(f"{label}: {words}")
