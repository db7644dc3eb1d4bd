"""Names that stand more than once in an FMU's description, which no case may use."""

from collections.abc import Iterator

from simulation.case import Case
from studies.doctor.finding import Finding, named


def look_at_names(case: Case) -> Iterator[Finding]:
    """Name variables with one name; the case uses none of them, else it could not be read."""
    twice = [one.twice for one in case.fmu.variables.values() if one.namesakes]
    yield from named("twice", twice, "; ")
