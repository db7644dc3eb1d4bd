"""Which parameters cannot be moved to their bounds, from where on, and why."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.forward_model import ForwardModel
from simulation.trajectories import Trajectories
from studies.doctor.finding import Finding, named
from studies.report.wording import percent, shown_unit

N_HALVINGS = 5
"""Rows that find out from where on a bound fails: to 1/32 of the way to it."""
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")


def commonest(failures: Sequence[str]) -> str:
    """Return an example of the reason that most rows failed for, whatever numbers it holds; "" for none."""
    reasons = [reason for reason in failures if reason]
    if not reasons:
        return ""
    ((kind, _),) = Counter(_NUMBER.sub("#", reason) for reason in reasons).most_common(1)
    return next(reason for reason in reasons if _NUMBER.sub("#", reason) == kind)


def look_at_bounds(
    case: Case, base: FloatArray, answer: Trajectories, model: ForwardModel | None
) -> Iterator[Finding]:
    """Say which single parameters cannot be moved to a bound, from where on, and why.

    Args:
        case: The case.
        base: The estimates. Shape (p,). [per parameter]
        answer: The answers to `moved_points`, or to the first of them.
        model: Shows from where on a bound fails; None where there is no time for that.
    """
    failed, space = np.flatnonzero(answer.failed), case.parameter_space
    if not len(failed):
        return
    good, bad = np.tile(space.to_unit(base), (len(failed), 1)), space.to_unit(answer.theta[failed])
    for _ in range(N_HALVINGS):
        if model is not None:
            middle = 0.5 * (good + bad)
            is_good = ~model.simulate(space.from_unit(middle)).failed[:, None]
            good, bad = np.where(is_good, middle, good), np.where(is_good, bad, middle)
    regions = []
    for row, edge in zip(failed, space.from_unit(good), strict=True):
        one, is_upper = space.parameters[row // 2], bool(row % 2)
        bound, where, side = (one.upper, "above", "upper") if is_upper else (one.lower, "below", "lower")
        begin = "" if model is None else f"{where} {edge[row // 2]:.3g}, "
        regions.append(
            f"{one.name} fails {begin}at its {side} bound {bound:.4g} {shown_unit(one.unit)}".rstrip()
        )
    share, reason = percent(len(failed) / answer.n), commonest(answer.failures)
    yield from named("bounds-fail", regions, "; ", share=share, reason=reason)
