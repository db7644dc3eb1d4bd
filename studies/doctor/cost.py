"""What a plan will cost, said before it is spent."""

from collections.abc import Iterator

from simulation.case import Case
from studies.console import format_seconds
from studies.doctor.finding import Finding, finding
from studies.profile import Profile
from studies.report.wording import count

LEAST_TIMES = 3.0
"""A time-out of fewer times the simulation of the estimates stops rows that are only somewhat harder."""


def planned_simulations(case: Case, profile: Profile) -> dict[str, int]:
    """Return how many simulations a profile asks for, by purpose."""
    p, n = case.parameter_space.n_parameters, len(profile.data.n_train)
    return {
        "training": max(profile.data.n_train),
        "validation": profile.data.n_validation,
        "test": profile.data.n_test,
        "sensitivity": profile.sensitivity.n_base * (p + 2),
        "calibration at most": n * (profile.polish.max_calls + 1),
    }


def look_at_cost(case: Case, profile: Profile, simulation_s: float, n_workers: int) -> Finding:
    """Say what the profile costs on this machine.

    Polishing goes one simulation after the other or a Jacobian at a time, so the true time lies above a share
    by the workers: that part is counted for one worker.
    """
    planned = planned_simulations(case, profile)
    total, alone = sum(planned.values()), planned["calibration at most"]
    return finding(
        "cost",
        "ok",
        profile=profile.name,
        each=duration(simulation_s),
        total=total,
        time=format_seconds(simulation_s * ((total - alone) / n_workers + alone)),
        workers=f"{n_workers} workers" if n_workers > 1 else "one worker",
        trainings=count(len(profile.data.n_train) * profile.tuning.n_trials, "training"),
    )


def look_at_timeout(case: Case, simulation_s: float) -> Iterator[Finding]:
    """Name a time-out that is near to what a simulation takes."""
    timeout_s = case.policy.timeout_s
    if timeout_s is not None and timeout_s < LEAST_TIMES * simulation_s:
        yield finding("timeout", limit=f"{timeout_s:g} s", each=duration(simulation_s))


def duration(seconds: float) -> str:
    """Write a time: in milliseconds where it is short."""
    return f"{1000.0 * seconds:.3g} ms" if seconds < 1.0 else format_seconds(seconds)
