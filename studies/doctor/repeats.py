"""Whether a question gets the same answer again, after others and in another process."""

from collections.abc import Iterator, Sequence

import numpy as np

from simulation.trajectories import Trajectories
from studies.circumstances import WAYS
from studies.doctor.answers import SAME
from studies.doctor.finding import Finding, finding
from studies.doctor.storing import MORE_TIME, STOPPED

_COSTS = {"state": "goes back to a saved state", "new instance": "gets a new instance"}


def look_at_repeats(first: Trajectories, again: Sequence[Trajectories], fresh: Trajectories) -> Finding:
    """Compare answers to the estimates.

    Args:
        first: the first answer of a process.
        again: later answers of the same process, other rows in between.
        fresh: the first answer of another process.
    """
    if reason := next((one.failures[0] for one in (*again, fresh) if one.failed[0]), ""):
        return finding("repeats-fail", "fail", reason=reason)
    between, within = _apart(first, fresh), max((_apart(first, one) for one in again), default=0.0)
    if between > SAME:
        return finding("random", "fail", apart=between)
    if within > SAME:
        return finding("keeps-a-state", "fail", apart=within)
    most = max(between, within)
    return finding("repeats", "ok", exact="bit for bit" if most == 0.0 else f"within {most:.1g}")


def look_at_restart(answer: Trajectories) -> Iterator[Finding]:
    """Say how rows are started over, by the answer of a RestartModel; nothing where it failed or is slow."""
    way = "undecided" if answer.failed[0] else WAYS[round(float(answer.y[0, 0, -1]))]
    if way == "reset":
        yield finding("restart", "ok")
    elif way != "undecided":
        yield finding("restart-fails", cost=_COSTS.get(way, "gets a new process"))


def look_at_order(later: Trajectories, first: Trajectories) -> Finding:
    """Compare answers to a point of the box: what a process keeps of its first row falsifies all others.

    Args:
        later: the answer of a process that answered another row before.
        first: the first answer of another process.
    """
    if later.failed[0] and first.failed[0]:
        return finding("order", "ok", said="a point of the box fails, first and later")
    # On a busy machine that is no sign of what the FMU keeps.
    if any(STOPPED in answer.failures[0] for answer in (later, first)):
        return finding("order-timeout", remedy=MORE_TIME)
    apart = _apart(later, first)
    if apart <= SAME:
        return finding("order", "ok", said="first in a process, and after other parameters")
    said = f"the same parameters give outputs {apart:.3g} apart first in a process and after others"
    if np.isnan(apart):
        said = "a point of the box fails either first in a process or after others, not both"
    return finding("keeps-first-parameters", "fail", said=said)


def _apart(one: Trajectories, other: Trajectories) -> float:
    return float(np.max(np.abs(one.y - other.y)))
