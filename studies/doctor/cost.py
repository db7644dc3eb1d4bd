"""What a plan will cost, said before it is spent."""

import math

from simulation.case import Case
from simulation.pool.execution import SLOWER as SLOWER_THAN_ANY
from studies.console import format_seconds
from studies.doctor.finding import Finding
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


def tell_cost(case: Case, profile: Profile, simulation_s: float, n_workers: int) -> Finding:
    """Say what the profile costs on this machine.

    Polishing goes one simulation after the other or a Jacobian at a time, so the true time lies above a share
    by the workers: that part is counted for one worker.
    """
    planned = planned_simulations(case, profile)
    total = sum(planned.values())
    alone = planned["calibration at most"]
    seconds = simulation_s * ((total - alone) / n_workers + alone)
    trainings = len(profile.data.n_train) * profile.tuning.n_trials
    workers = f"{n_workers} workers" if n_workers > 1 else "one worker"
    return Finding(
        f"cost of profile {profile.name}",
        "ok",
        f"{_duration(simulation_s)} per simulation; at most {total} simulations, "
        f"{format_seconds(seconds)} with {workers}; {count(trainings, 'training')}",
    )


def tell_timeout(case: Case, simulation_s: float) -> Finding:
    """Propose a time-out where there is none."""
    if case.policy.timeout_s is not None:
        tight = case.policy.timeout_s < 3.0 * simulation_s
        limit = f"{case.policy.timeout_s:g} s" if math.isfinite(case.policy.timeout_s) else "never"
        return Finding(
            "time-out",
            "warn" if tight else "ok",
            f"{limit}; the estimates take {_duration(simulation_s)}",
            "raise [simulation] timeout_s: other parameters may take longer" if tight else "",
        )
    proposed = max(LEAST_TIMEOUT_S, float(f"{SLOWER * simulation_s:.1g}"))
    return Finding(
        "time-out",
        "ok",
        f"{case.policy.limit_s(simulation_s):g} s or more, {SLOWER_THAN_ANY:g} times the slowest so far; for "
        f"another: [simulation] timeout_s = {proposed:g}, or inf for never",
    )


def _duration(seconds: float) -> str:
    return f"{1000.0 * seconds:.3g} ms" if seconds < 1.0 else format_seconds(seconds)
