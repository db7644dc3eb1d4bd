"""What the data say about parameters near an optimum: singular values of the Jacobian.

In the case's own scales (logarithmic where declared), each parameter's range counting 1. With the Jacobian J,
residuals of standard deviation s, and a box in which every point was as likely before (variance 1/12), the
estimates scatter with the covariance (J'J / s^2 + 12)^-1: what the data leave open, the box limits. Residuals
of a room follow each other, so s is raised by the root of how many samples stand for one independent one.
Bounds are looked away from: at one of them a parameter would go on if it might.
"""

from dataclasses import dataclass, replace

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.prior import Prior
from studies.calibration.problem import Evaluation

DETERMINED = 0.1
"""A standard deviation below this share of the range counts as determined by the data; where something was
known before, below the same part of what it was then."""

A_PAIR = 0.7
"""A direction that two parameters make up to this share of its squared length is theirs."""

NULL, NULL_PER_STEP = 1e-6, 5e-3
"""Singular values below this share of the largest are none: the differences are no more exact."""

# One over the variance of an even density on [0, 1], which is 1/12.
BOX_PRECISION = 12.0
"""Of a parameter that may be anywhere in its range."""


@dataclass(frozen=True)
class Pair:
    """Two parameters of which one makes up for the other.

    Attributes:
        first: Name of the one.
        second: Name of the other.
        strength: A correlation, or a direction's share: above 0 the two rise together, below 0 one makes up
            for the other.
    """

    first: str
    second: str
    strength: float

    @property
    def in_words(self) -> str:
        """How the two compensate."""
        how = "rise together" if self.strength > 0 else "one rises as the other falls"
        return f"{self.first} and {self.second}: {how} ({self.strength:+.2f})"


@dataclass(frozen=True)
class Identifiability:
    """What a measurement says about each parameter near one point.

    Attributes:
        names: Names of the p parameters.
        singular_values: Of the Jacobian, falling. Shape (p,). [first output's unit per range]
        directions: Right singular vectors, one per row. Shape (p, p). [1]
        noise: Standard deviation of the residuals, raised for those that follow each other.
            [first output's unit]
        spread: Standard deviation of each parameter, as a share of its range. Shape (p,). [1]
        before: The same without data, of the range or a prior within it. Shape (p,). [1]
        is_unknown: Which parameters could not be moved, their differences having failed. Shape (p,).
        null: Share of the largest singular value below which the others are none. [1]
    """

    names: tuple[str, ...]
    singular_values: FloatArray
    directions: FloatArray
    noise: float
    spread: FloatArray
    before: FloatArray
    is_unknown: BoolArray
    null: float = NULL

    @property
    def determined(self) -> tuple[str, ...]:
        """Parameters that the data determine."""
        # Without a prior `before` is the root of 1/12, so this is a tenth of the range.
        limit = DETERMINED * np.sqrt(BOX_PRECISION) * self.before
        return tuple(n for n, is_so in zip(self.names, self.spread < limit, strict=True) if is_so)

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Pairs that the data cannot distinguish: the directions left open that two parameters make up."""
        found = []
        # Noise over singular value is a direction's deviation; multiplied out, a value of 0 divides nothing.
        n_determined = int(np.sum(self.noise < DETERMINED * self.singular_values))
        # The least determined direction comes first: singular values fall.
        for direction in self.directions[n_determined:][::-1]:
            i, j = np.argsort(-(direction**2))[:2] if len(direction) > 1 else (0, 0)
            share = float(direction[i] ** 2 + direction[j] ** 2)
            # Both must matter: a parameter alone that moves nothing compensates none.
            if i != j and share >= A_PAIR and abs(direction[j]) >= 0.5 * abs(direction[i]):
                first, second = sorted((int(i), int(j)))
                sign = 1.0 if direction[first] * direction[second] > 0 else -1.0
                found.append(Pair(self.names[first], self.names[second], sign * share))
        return tuple(found)

    @property
    def null_directions(self) -> tuple[str, ...]:
        """Combinations that change no output at all near the point, e.g. "+0.71 cExt1 −0.70 rExt2"."""
        found = []
        for rank in np.flatnonzero(self.singular_values <= self.null * self.singular_values[0]):
            direction = self.directions[rank]
            # What could not be moved has no slope, but is not known to change nothing.
            if np.sum(direction[self.is_unknown] ** 2) < 0.5:
                most = [i for i in np.argsort(-np.abs(direction)) if abs(direction[i]) >= 0.1]
                terms = " ".join(f"{direction[i]:+.2f} {self.names[i]}" for i in most)
                found.append(terms.replace("-", "\N{MINUS SIGN}"))
        return tuple(found)


def difference_rows(u: FloatArray, step: float) -> FloatArray:
    """Return a point, then one row per parameter moved up, then one per parameter moved down.

    Args:
        u: The point in the unit cube. Shape (p,). [1]
        step: How far; a bound cuts it. [1]

    Returns:
        Shape (2 p + 1, p). [1]
    """
    # At a bound the difference is one-sided, as nothing says that the model answers beyond it.
    ahead, behind = np.minimum(u + step, 1.0), np.maximum(u - step, 0.0)
    is_moved = np.eye(len(u), dtype=np.bool_)
    return np.concatenate([u[None], np.where(is_moved, ahead, u), np.where(is_moved, behind, u)])


def judged(
    names: tuple[str, ...],
    answer: Evaluation,
    raised: float,
    step: float,
    *,
    prior: Prior | None = None,
) -> Identifiability:
    """Read off what residuals around a point determine.

    Args:
        names: Names of the p parameters.
        answer: The model at `difference_rows`.
        raised: Noise, raised for residuals that follow each other; above 0. [first output's unit]
        step: The step of the differences. [1]
        prior: What is known beforehand, or None.
    """
    p = answer.u.shape[1]
    # The error of differences grows with their step, and singular values below it are that error.
    slopes, null = _slopes(answer).T, max(NULL, NULL_PER_STEP * step)
    found = judged_slopes(names, slopes, raised, null=null, prior=prior)
    is_unknown = np.array([all(answer.failures[row] for row in (j + 1, j + 1 + p)) for j in range(p)])
    return replace(found, is_unknown=is_unknown)


def judged_slopes(
    names: tuple[str, ...],
    jacobian: FloatArray,
    raised: float,
    *,
    null: float = NULL,
    prior: Prior | None = None,
) -> Identifiability:
    """Read off what slopes of residuals at a point determine, however these are known.

    Args:
        names: Names of the p parameters.
        jacobian: The slopes, in any orthonormal basis of the residuals. Shape (m, p).
            [first output's unit per range]
        raised: Noise, raised for residuals that follow each other; above 0. [first output's unit]
        null: Share of the largest singular value below which the others are none. [1]
        prior: What is known beforehand, or None.

    """
    p = len(names)
    # With fewer residuals than parameters the full V also has the directions that no residual sees.
    _, values, directions = np.linalg.svd(jacobian, full_matrices=len(jacobian) < p)
    # Those directions have singular value 0.
    values = np.pad(values, (0, p - len(values)))
    # From the singular values: J'J itself would square the condition of J and lose the open directions.
    covariance = (directions.T / ((values / raised) ** 2 + BOX_PRECISION)) @ directions
    known = np.full(p, BOX_PRECISION)
    if prior is not None:
        known = known + prior.width**-2.0
        # Precisions of independent knowledge add up; thanks to the box neither inverse is singular.
        covariance = np.linalg.inv(np.linalg.inv(covariance) + np.diag(prior.width**-2.0))
    return Identifiability(
        names=names,
        singular_values=values,
        directions=directions,
        noise=raised,
        spread=np.sqrt(np.diag(covariance)),
        before=1.0 / np.sqrt(known),
        is_unknown=np.zeros(p, dtype=np.bool_),
        null=null,
    )


def _slopes(answer: Evaluation) -> FloatArray:
    """Return a row of the residuals' slopes per parameter, 0 where both sides fail. Shape (p, m).

    Where one side fails, the point itself takes its place.

    Args:
        answer: The model at `difference_rows`.
    """
    u, p = answer.u[0], answer.u.shape[1]
    ends = []
    for side in (slice(1, p + 1), slice(p + 1, None)):
        residuals = answer.residuals[side]
        # One failed side leaves a one-sided difference, which is less exact but says more than none.
        is_good: BoolArray = np.all(np.isfinite(residuals), axis=1)
        there = np.where(is_good, np.diag(answer.u[side]), u)
        ends.append((there, np.where(is_good[:, None], residuals, answer.residuals[0])))
    (ahead, above), (behind, below) = ends
    # Where both sides failed the slope becomes 0 / 1, not 0 / 0.
    width = np.where(ahead > behind, ahead - behind, 1.0)
    return (above - below) / width[:, None]
