"""What the doctor finds: one line each, with what to do, and the diagnosis they make."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

from studies.console import Column, Console

Level = Literal["ok", "warn", "fail"]


@dataclass(frozen=True)
class Finding:
    """One thing the doctor looked at.

    Args:
        what: what was examined.
        level: ok, warn (the study can go on) or fail (it cannot).
        found: what was found, with numbers.
        remedy: what to do; empty when all is well.
    """

    what: str
    level: Level
    found: str
    remedy: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """All findings about a case.

    Args:
        findings: one per examination.
        simulation_s: time of one simulation. [s]
        planned_simulations: simulations the profile asks for, by purpose.
    """

    findings: tuple[Finding, ...]
    simulation_s: float
    planned_simulations: dict[str, int]

    @property
    def is_sound(self) -> bool:
        """Whether nothing failed."""
        return all(finding.level != "fail" for finding in self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis as JSON values."""
        return {
            "sound": self.is_sound,
            **asdict(self),
            "findings": [asdict(found) for found in self.findings],
        }


def say_warnings(console: Console, diagnosis: Diagnosis) -> None:
    """Say in one line each what a study may go on with and its user should know."""
    for finding in diagnosis.findings:
        if finding.level == "warn":
            console.say(f"check: {finding.what}: {finding.found}; {finding.remedy}")


def show_diagnosis(console: Console, label: str, diagnosis: Diagnosis) -> None:
    """Print the findings as a table, and what they come to."""
    console.table(
        f"{label}: what the doctor found",
        [Column("examined"), Column("result"), Column("found"), Column("what to do")],
        [[found.what, found.level, found.found, found.remedy] for found in diagnosis.findings],
    )
    levels = [finding.level for finding in diagnosis.findings]
    words = f"{levels.count('fail')} failed, {levels.count('warn')} to look at, {levels.count('ok')} good"
    console.result(f"{label}: {words}")
