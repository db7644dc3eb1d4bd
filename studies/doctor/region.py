"""Where in the box simulations fail, in words: beyond which value of which parameter, and why."""

import re
from collections import Counter
from collections.abc import Sequence

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case import Case
from simulation.forward_model import ForwardModel
from simulation.parameters import ParameterSpace
from simulation.trajectories import Trajectories
from studies.doctor.finding import Finding
from studies.report.wording import percent, shown_unit

N_HALVINGS = 5
"""Rows that find out from where on a bound fails: to 1/32 of the way to it."""
EXPLAINED = 0.9
"""One parameter explains failures that separates so much of the failed rows from the others."""
LONGEST = 3
"""Regions named in one line."""
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?")


def commonest(failures: Sequence[str]) -> str:
    """Return an example of the reason that most rows failed for, whatever numbers it holds."""
    reasons = [reason for reason in failures if reason]
    ((kind, _),) = Counter(_NUMBER.sub("#", reason) for reason in reasons).most_common(1)
    return next(reason for reason in reasons if _NUMBER.sub("#", reason) == kind)


def failing_region(space: ParameterSpace, theta: FloatArray, failed: BoolArray) -> str:
    """Say beyond which value of one parameter rows fail, "" where no single one explains it.

    Args:
        space: The parameters.
        theta: The rows. Shape (n, p). [per parameter]
        failed: Which failed. Shape (n,).
    """
    if not failed.any() or failed.all():
        return ""
    u, best = space.to_unit(theta), (EXPLAINED, "")
    for j, parameter in enumerate(space.parameters):
        values = np.unique(u[:, j])
        for edge in 0.5 * (values[1:] + values[:-1]):
            is_below = u[:, j] < edge
            for is_region, where in ((is_below, "below"), (~is_below, "above")):
                part = min(float(is_region[failed].mean()), float(1.0 - is_region[~failed].mean()))
                if part > best[0]:
                    value = space.from_unit(np.where(np.arange(u.shape[1]) == j, edge, 0.5))[j]
                    text = f"{parameter.name} {where} {value:.3g} {shown_unit(parameter.unit)}".rstrip()
                    best = part, f"mostly with {text}" if part < 1.0 else f"all with {text}"
    return best[1]


def look_at_bounds(
    case: Case, base: FloatArray, answer: Trajectories, model: ForwardModel | None
) -> Finding | None:
    """Say which single parameters cannot be moved to a bound, from where on, and why.

    Args:
        case: The case.
        base: The estimates. Shape (p,). [per parameter]
        answer: The answers to `moved_points`, or to the first of them.
        model: Shows from where on a bound fails; None where there is no time for that.

    Returns:
        The finding, None where no bound fails.
    """
    failed = np.flatnonzero(answer.failed)
    if not len(failed):
        return None
    space = case.parameter_space
    good, bad = np.tile(space.to_unit(base), (len(failed), 1)), space.to_unit(answer.theta[failed])
    for _ in range(N_HALVINGS if model is not None else 0):
        assert model is not None, "nothing is halved without one"
        middle = 0.5 * (good + bad)
        is_good = ~model.simulate(space.from_unit(middle)).failed
        good, bad = np.where(is_good[:, None], middle, good), np.where(is_good[:, None], bad, middle)
    regions = []
    for row, edge in zip(failed, space.from_unit(good), strict=True):
        j, is_upper = divmod(int(row), 2)
        parameter = space.parameters[j]
        bound, where = (parameter.upper, "above") if is_upper else (parameter.lower, "below")
        from_where = f"{where} {edge[j]:.3g}, " if model is not None else ""
        regions.append(
            f"{parameter.name} fails {from_where}at its {'upper' if is_upper else 'lower'} bound "
            f"{bound:.4g} {shown_unit(parameter.unit)}".rstrip()
        )
    share = len(failed) / answer.n
    more = f" and {len(regions) - LONGEST} more" if len(regions) > LONGEST else ""
    return Finding(
        "every parameter reaches its bounds",
        "warn",
        f"{'; '.join(regions[:LONGEST])}{more} ({percent(share)} of the bounds); the reason: "
        f"{commonest(answer.failures)}",
        "narrow these bounds to where the model can be simulated, if what lies beyond is not wanted",
    )
