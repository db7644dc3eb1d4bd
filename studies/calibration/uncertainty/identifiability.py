"""What the data say about parameters near an optimum: singular values of the Jacobian.

In the case's own scales (logarithmic where declared), each parameter's range counting 1. With the Jacobian J,
residuals of standard deviation s, and a box in which every point was as likely before (variance 1/12), the
estimates scatter with the covariance (J'J / s^2 + 12)^-1: what the data leave open, the box limits. Residuals
of a room follow each other, so s is raised by the root of how many samples stand for one independent one.
Bounds are looked away from: at one of them a parameter would go on if it might.
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.differences import difference_slopes
from studies.calibration.prior import Prior
from studies.calibration.problem import Evaluation

DETERMINED = 0.1
"""A standard deviation below this share of the range counts as determined by the data; where something was
known before, below the same part of what it was then."""

A_PAIR = 0.9
"""Two open parameters of at least this correlation are a pair: less than half of one's deviation is left
where the other one is known."""

ALIKE = 0.3
"""Cosine in the open directions from which one parameter makes up for a part of another. By hand."""

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
        strength: Their correlation: above 0 the two rise together, below 0 one rises as the other falls. [1]
    """

    first: str
    second: str
    strength: float

    @property
    def how(self) -> str:
        """How the two compensate."""
        return "the two rise together" if self.strength > 0 else "one rises as the other falls"


@dataclass(frozen=True)
class Ridge:
    """Two parameters or more that make up for each other.

    Attributes:
        names: Names of the n parameters.
        n_free: How many of them the data leave free: the data determine n - n_free combinations of the n.
    """

    names: tuple[str, ...]
    n_free: int


@dataclass(frozen=True)
class Identifiability:
    """What a measurement says about each parameter near one point.

    Attributes:
        names: Names of the p parameters.
        singular_values: Of the Jacobian, falling. Shape (p,). [first output's unit per range]
        directions: Right singular vectors, one per row. Shape (p, p). [1]
        noise: Standard deviation of the residuals, raised for those that follow each other.
            [first output's unit]
        covariance: Of the parameters, as shares of their ranges. Shape (p, p). [1]
        before: The same without data, of the range or a prior within it. Shape (p,). [1]
        is_unknown: Which parameters could not be moved, their differences having failed. Shape (p,).
        null: Share of the largest singular value below which the others are none. [1]
    """

    names: tuple[str, ...]
    singular_values: FloatArray
    directions: FloatArray
    noise: float
    covariance: FloatArray
    before: FloatArray
    is_unknown: BoolArray
    null: float = NULL

    @property
    def spread(self) -> FloatArray:
        """Standard deviation of each parameter, as a share of its range. Shape (p,). [1]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def determined(self) -> tuple[str, ...]:
        """Parameters that the data determine."""
        return tuple(n for n, is_so in zip(self.names, self._is_open, strict=True) if not is_so)

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Pairs of open parameters of which the data know one exactly where the other is known."""
        correlations, is_open = self.covariance / np.outer(self.spread, self.spread), self._is_open
        return tuple(
            Pair(self.names[i], self.names[j], float(correlations[i, j]))
            for i, j in combinations(np.flatnonzero(is_open).tolist(), 2)
            if abs(correlations[i, j]) >= A_PAIR
        )

    @property
    def ridges(self) -> tuple[Ridge, ...]:
        """Groups of open parameters that make up for each other, by the directions that the data leave open.

        Parameters that no other one makes up for are in none.
        """
        # Noise over singular value is a direction's deviation; multiplied out, a value of 0 divides nothing.
        is_known = self.noise < DETERMINED * self.singular_values
        # What is left of each parameter in the open directions, and how alike that is.
        shares = self.directions[~is_known].T @ self.directions[~is_known]
        sizes = np.sqrt(np.diag(shares)) + np.finfo(float).tiny
        is_alike = np.abs(shares) >= ALIKE * np.outer(sizes, sizes)
        left, found = set(np.flatnonzero(self._is_open).tolist()), list[Ridge]()
        while left:
            group, news = set[int](), {min(left)}
            while news:
                group |= news
                news = {j for i in news for j in left - group if is_alike[i, j]}
            left -= group
            members = sorted(group)
            n_free = max(round(float(np.diag(shares)[members].sum())), 1)
            if n_free < len(members):
                found.append(Ridge(tuple(self.names[i] for i in members), n_free))
        return tuple(found)

    @property
    def _is_open(self) -> BoolArray:
        """Which parameters the data leave open. Shape (p,)."""
        # Without a prior `before` is the root of 1/12, so this is a tenth of the range.
        return np.asarray(self.spread >= DETERMINED * np.sqrt(BOX_PRECISION) * self.before)

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
    slopes, null = difference_slopes(answer.u, answer.residuals).T, max(NULL, NULL_PER_STEP * step)
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
        covariance=np.asarray(covariance, dtype=np.float64),
        before=1.0 / np.sqrt(known),
        is_unknown=np.zeros(p, dtype=np.bool_),
        null=null,
    )
