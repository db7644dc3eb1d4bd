"""Whether a question gets the same answer again, after others and in another process; and memory."""

from collections.abc import Sequence

import numpy as np
import psutil

from simulation.trajectories import Trajectories
from studies.circumstances import WAYS
from studies.doctor.answers import SAME
from studies.doctor.finding import Finding
from studies.doctor.keeping import MORE_TIME, STOPPED

N_MEMORY = 200
MEMORY_S = 10.0
"""Longest that memory is watched. [s]"""
LEAK_BYTES = 20_000
"""A process that grows by more than this with each simulation, again and again, leaks. [B]"""


def look_at_repeats(first: Trajectories, again: Sequence[Trajectories], fresh: Trajectories) -> Finding:
    """Compare answers to the estimates.

    Args:
        first: the first answer of a process.
        again: later answers of the same process, other rows in between.
        fresh: the first answer of another process.
    """
    what = "the same answer again"
    if failed := next((one.failures[0] for one in (*again, fresh) if one.failed[0]), ""):
        return Finding(
            what,
            "fail",
            f"the estimates could be simulated once, then not: {failed}",
            "try it in another tool",
        )
    between = _apart(first, fresh)
    if not between <= SAME:
        return Finding(
            what,
            "fail",
            f"two new processes give outputs {between:.3g} apart for the same parameters",
            "the FMU draws random numbers, reads a clock or memory it never set; have it corrected",
        )
    within = max((_apart(first, one) for one in again), default=0.0)
    if not within <= SAME:
        return Finding(
            what,
            "fail",
            f"the same parameters give outputs {within:.3g} apart after other simulations",
            "the FMU keeps a state over fmi2Reset; have its exporter corrected",
        )
    most = max(between, within)
    exact = "bit for bit" if most == 0.0 else f"within {most:.1g}"
    return Finding(what, "ok", f"{exact}, after other simulations and in another process")


def look_at_restart(answer: Trajectories) -> Finding | None:
    """Say how rows are started over.

    Args:
        answer: the answer of a RestartModel.

    Returns:
        The finding; None where nothing can be said: the row failed, or rows are too slow to try.
    """
    if answer.failed[0]:
        return None
    what, way = "starting the FMU over", WAYS[round(float(answer.y[0, 0, -1]))]
    if way == "reset":
        return Finding(what, "ok", "a reset forgets the row before")
    if way == "undecided":
        return None
    cost = {"state": "goes back to a saved state", "new instance": "gets a new instance"}
    return Finding(
        what,
        "warn",
        f"its reset fails or does not forget the row before: each row {cost.get(way, 'gets a new process')}",
        "results are right, only slower; have its exporter corrected",
    )


def look_at_order(later: Trajectories, first: Trajectories) -> Finding:
    """Compare answers to a point of the box: what a process keeps of its first row falsifies all others.

    Args:
        later: the answer of a process that answered another row before.
        first: the first answer of another process.
    """
    what = "the same answer in any order"
    if later.failed[0] and first.failed[0]:
        return Finding(what, "ok", "a point of the box fails, first and later")
    # On a busy machine that is no sign of what the FMU keeps.
    if any(STOPPED in answer.failures[0] for answer in (later, first)):
        said = "a point of the box ran into the time-out first in a process or after others, not both"
        return Finding(what, "warn", said, MORE_TIME)
    apart = _apart(later, first)
    if apart <= SAME:
        return Finding(what, "ok", "first in a process, and after other parameters")
    return Finding(
        what,
        "fail",
        "a point of the box fails either first in a process or after others, not both"
        if np.isnan(apart)
        else f"the same parameters give outputs {apart:.3g} apart first in a process and after others",
        "the FMU keeps its first parameters while its process lives; have its exporter corrected",
    )


def memory_in_use() -> int:
    """Return the memory of the largest process below this one. [B]."""
    sizes = [0]
    for child in psutil.Process().children(recursive=True):
        try:
            sizes.append(child.memory_info().rss)
        except psutil.Error:
            continue
    return max(sizes)


def look_at_memory(grown_bytes: int, n_rows: int, n_planned: int) -> Finding:
    """Judge how a process grows.

    Args:
        grown_bytes: how much it grew. [B]
        n_rows: over so many simulations.
        n_planned: simulations that the profile asks for.
    """
    each = grown_bytes / n_rows
    if each < LEAK_BYTES:
        return Finding("memory", "ok", f"does not grow over {n_rows} simulations")
    return Finding(
        "memory",
        "warn",
        f"grows by {each / 1e6:.2g} MB with each simulation, {each * n_planned / 1e9:.3g} GB over the plan",
        "processes are replaced before that hurts; have the FMU's exporter corrected",
    )


def _apart(one: Trajectories, other: Trajectories) -> float:
    return float(np.max(np.abs(one.y - other.y)))
