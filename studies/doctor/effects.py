"""Whether every parameter moves an output: from the estimates, from other points, over all experiments."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.case import Case
from simulation.trajectories import Trajectories
from studies.doctor.asking import NOT_DONE
from studies.doctor.finding import Finding, finding

SAME = 1e-9
"""Two answers of one model to one question differ by no more than this. [output's unit]"""
UNSEEN_SHARE = 0.01
"""A parameter that moves the output by less than this share of the uncertainty cannot be identified."""
N_OTHERS = 4
"""Points beside the estimates from which a parameter is moved that seems to do nothing."""


@dataclass(frozen=True, eq=False)
class Effects:
    """How far each parameter moves an output, NaN where simulations at both of its bounds fail.

    Args:
        names: the parameters. Length p.
        here: from the estimates. Shape (p,). [uncertainties]
        most: from the point where it moves it most. Shape (p,). [uncertainties]
        is_asked: whether there was time to move it. Shape (p,).
        is_unknown: whether it is NaN in some experiment. Shape (p,).
        has_estimates: whether the case declares an estimate of every parameter.
    """

    names: tuple[str, ...]
    here: FloatArray
    most: FloatArray
    is_asked: BoolArray
    is_unknown: BoolArray
    has_estimates: bool

    @classmethod
    def of(cls, case: Case, nominal: Trajectories, answer: Trajectories) -> "Effects":
        """Return the effects at the estimates.

        Args:
            case: the case.
            nominal: the answer that they are compared with, one row.
            answer: the answers to `moved_points`.
        """
        here = influence(case, nominal, answer)
        pairs = zip(answer.failures[::2], answer.failures[1::2], strict=True)
        is_asked = np.array([NOT_DONE not in pair for pair in pairs], dtype=np.bool_)
        return cls(
            names=case.parameter_space.names,
            here=here,
            most=here,
            is_asked=is_asked,
            is_unknown=np.isnan(here),
            has_estimates=has_estimates(case),
        )

    @property
    def seem_idle(self) -> IntArray:
        """Parameters that may do more from other points."""
        return np.flatnonzero(self.is_asked & ~(self.most >= UNSEEN_SHARE))

    def also(self, chosen: IntArray, there: FloatArray) -> "Effects":
        """Return the same with what some parameters do from another point.

        Args:
            chosen: Which parameters. Shape (q,).
            there: What they do there. Shape (q,). [uncertainties]
        """
        most = self.most.copy()
        most[chosen] = np.fmax(most[chosen], there)
        return Effects(
            self.names, self.here, most, self.is_asked, self.is_unknown & np.isnan(most), self.has_estimates
        )


def has_estimates(case: Case) -> bool:
    """Say whether the case declares an estimate of every parameter; else the middle of the box is none."""
    return all(one.estimate is not None for one in case.parameter_space.parameters)


def over_experiments(case: Case, found: Sequence[Effects | None]) -> Effects:
    """Return what parameters do in any of a case's experiments.

    Args:
        case: the case with experiments.
        found: what they do in each of them; None where nothing could be simulated.
    """
    p = case.parameter_space.n_parameters
    here, most = np.full(p, np.nan), np.full(p, np.nan)
    is_asked, is_unknown = np.ones(p, dtype=np.bool_), np.zeros(p, dtype=np.bool_)
    for (experiment, _), effects in zip(case.members, found, strict=True):
        columns = experiment.parameters
        if effects is None:
            is_asked[columns] = False
            continue
        here[columns] = np.fmax(here[columns], effects.here)
        most[columns] = np.fmax(most[columns], effects.most)
        is_asked[columns] &= effects.is_asked
        is_unknown[columns] |= effects.is_unknown
    # What it does in one experiment is enough.
    is_asked |= most >= UNSEEN_SHARE
    return Effects(case.parameter_space.names, here, most, is_asked, is_unknown, has_estimates(case))


def moved_points(case: Case, base: FloatArray, chosen: IntArray | None = None) -> FloatArray:
    """Move parameters to both of their ends, one at a time. Shape (2 q, p).

    Args:
        case: The case.
        base: From where. Shape (p,). [per parameter]
        chosen: Which q parameters; None for all. Shape (q,).
    """
    space = case.parameter_space
    columns = np.arange(len(base)) if chosen is None else chosen
    lower, upper = space.ends(base)
    theta = np.tile(base, (2 * len(columns), 1))
    rows = 2 * np.arange(len(columns))
    theta[rows, columns], theta[rows + 1, columns] = lower[columns], upper[columns]
    return theta


def influence(case: Case, nominal: Trajectories, answer: Trajectories) -> FloatArray:
    """Return how far each parameter moves an output.

    Args:
        case: the case.
        nominal: the answer that they are compared with, one row.
        answer: the answers to `moved_points`.

    Returns:
        Largest change, NaN where both bounds failed. Shape (q,). [uncertainties]
    """
    moved = np.abs(answer.y - nominal.y[0]).max(axis=1) / case.measurement.uncertainty
    return np.asarray(np.fmax.reduce(moved.max(axis=1).reshape(-1, 2), axis=1))


def other_points(case: Case, known: Trajectories) -> Trajectories:
    """Return simulations from which parameters may do more: the best ones, and those that move most.

    Args:
        case: The case.
        known: Good simulations all over the box.
    """
    scaled = known.y / case.measurement.uncertainty
    best = np.argsort(case.measurement.mse(known.y), kind="stable")[: N_OTHERS // 2]
    liveliest = np.argsort(-np.ptp(scaled, axis=1).max(axis=1), kind="stable")[:N_OTHERS]
    return known.take(list(dict.fromkeys([*best.tolist(), *liveliest.tolist()]))[:N_OTHERS])


def look_at_effects(found: Effects) -> Finding | None:
    """Say whether every parameter moves an output; None where there was no time to look."""

    def which(is_so: np.ndarray) -> str:
        return ", ".join(found.names[i] for i in np.flatnonzero(is_so & found.is_asked))

    if not found.is_asked.any():
        return None
    if names := which((found.most <= SAME) & ~found.is_unknown):
        return finding("no-effect", "fail", names=names)
    # The middle of the box is no estimate.
    if found.has_estimates and (names := which((found.here <= SAME) & (found.most > SAME))):
        return finding("no-effect-here", names=names)
    if names := which(np.isnan(found.most) | ((found.most <= SAME) & found.is_unknown)):
        return finding("effect-unknown", names=names)
    weak = which((found.most < UNSEEN_SHARE) & ~found.is_unknown)
    least = int(np.argmin(np.where(found.is_asked, found.most, np.inf)))
    values = {"least": found.names[least], "most": found.most[least], "names": weak}
    return finding("effect", "warn" if weak else "ok", **values)
