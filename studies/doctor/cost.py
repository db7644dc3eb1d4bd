"""What a plan will cost, said before it is spent."""

import math

from simulation.case import Case
from simulation.pool.execution import SLOWER as SLOWER_THAN_ANY
from studies.console import format_seconds
from studies.doctor.finding import Finding, finding
from studies.doctor.patience import SLOWER
from studies.profile import Profile
from studies.report.wording import count

LEAST_TIMEOUT_S = 30.0
"""A time-out below this would stop simulations on a machine that is merely busy. [s]"""


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


def look_at_timeout(case: Case, simulation_s: float) -> Finding:
    """Judge the time-out, or propose one where there is none."""
    policy = case.policy
    if policy.timeout_s is not None:
        limit = f"{policy.timeout_s:g} s" if math.isfinite(policy.timeout_s) else "never"
        is_tight = policy.timeout_s < 3.0 * simulation_s
        return finding("timeout", "warn" if is_tight else "ok", limit=limit, each=duration(simulation_s))
    proposed = max(LEAST_TIMEOUT_S, float(f"{SLOWER * simulation_s:.1g}"))
    limit_s = policy.limit_s(simulation_s)
    return finding("no-timeout", "ok", limit=limit_s, slower=SLOWER_THAN_ANY, proposed=proposed)


def duration(seconds: float) -> str:
    """Write a time: in milliseconds where it is short."""
    return f"{1000.0 * seconds:.3g} ms" if seconds < 1.0 else format_seconds(seconds)
