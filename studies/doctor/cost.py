"""What a simulation costs, and whether the time-out of the case is near to it."""

from collections.abc import Iterator

from simulation.case import Case
from studies.console import format_seconds
from studies.doctor.finding import Finding, finding

LEAST_TIMES = 3.0
"""A time-out of fewer times the simulation of the estimates stops rows that are only somewhat harder."""


def look_at_cost(case: Case, simulation_s: float, command: str) -> Iterator[Finding]:
    """Say what a simulation takes, and name a time-out that is near to it."""
    yield finding("cost", "ok", each=duration(simulation_s), command=command)
    timeout_s = case.policy.timeout_s
    if timeout_s is not None and timeout_s < LEAST_TIMES * simulation_s:
        yield finding("timeout", limit=f"{timeout_s:g} s", each=duration(simulation_s))


def duration(seconds: float) -> str:
    """Write a time: in milliseconds where it is short."""
    return f"{1000.0 * seconds:.3g} ms" if seconds < 1.0 else format_seconds(seconds)
