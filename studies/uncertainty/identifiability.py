"""What the data say about parameters near an optimum: singular values and correlations of the Jacobian.

In the case's own scales (logarithmic where declared), each parameter's range counting 1. With the Jacobian J,
residuals of standard deviation s, and a box in which every point was as likely before (variance 1/12), the
estimates scatter with the covariance (J'J / s^2 + 12)^-1: what the data leave open, the box limits. Residuals
of a room follow each other, so s is raised by the root of how many samples stand for one independent one.
Bounds are looked away from: at one of them a parameter would go on if it might.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.counting import CountingModel
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from simulation.measurement import Measurement
from studies.calibration.prior import Prior
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.uncertainty.noise import noise_of

STEP = 1e-4
"""Step of the differences, as a share of the range."""

DETERMINED = 0.1
"""A standard deviation below this share of the range counts as determined by the data; where something was
known before, below the same part of what it was then."""

A_PAIR = 0.7
"""A direction that two parameters make up to this share of its squared length is theirs."""

ON_BOUND = 1e-3
"""Share of the range within which a parameter lies on its bound."""

NULL, NULL_PER_STEP = 1e-6, 5e-3
"""Singular values below this share of the largest are none: the differences are no more exact."""

BOX_VARIANCE = 1.0 / 12.0
"""Of a parameter that may be anywhere in its range."""


@dataclass(frozen=True)
class Pair:
    """Two parameters of which one can stand in for the other.

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

    def to_dict(self) -> dict[str, Any]:
        """Return the pair as JSON values."""
        return {**vars(self), "in_words": self.in_words}


@dataclass(frozen=True)
class Identifiability:
    """What a measurement says about each parameter near one point.

    Attributes:
        names: Names of the p parameters.
        theta: The point. Shape (p,). [per parameter]
        mse: Mean squared error there. [first output's unit squared]
        on_bound: Which parameters lie on a bound. Shape (p,).
        singular_values: Of the Jacobian, falling. Shape (p,). [first output's unit per range]
        directions: Right singular vectors, one per row. Shape (p, p). [1]
        noise: Standard deviation of the residuals, raised for those that follow each other.
            [first output's unit]
        spread: Standard deviation of each parameter, as a share of its range. Shape (p,). [1]
        before: The same without data, of the range or a prior within it. Shape (p,). [1]
        correlation: Of the estimates. Shape (p, p). [1]
        n_samples: Residuals.
        n_independent: Independent samples that they are worth.
        n_calls: Rows asked of the model.
        is_unknown: Which parameters could not be moved, their differences having failed. Shape (p,).
        null: Share of the largest singular value below which the others are none. [1]
    """

    names: tuple[str, ...]
    theta: FloatArray
    mse: float
    on_bound: BoolArray
    singular_values: FloatArray
    directions: FloatArray
    noise: float
    spread: FloatArray
    before: FloatArray
    correlation: FloatArray
    n_samples: int
    n_independent: float
    n_calls: int
    is_unknown: BoolArray
    null: float = NULL

    @property
    def determined(self) -> tuple[str, ...]:
        """Parameters that the data determine."""
        limit = DETERMINED / np.sqrt(BOX_VARIANCE) * self.before
        return tuple(n for n, is_so in zip(self.names, self.spread < limit, strict=True) if is_so)

    @property
    def n_determined_directions(self) -> int:
        """Combinations of parameters that the data determine."""
        return int(np.sum(self.noise < DETERMINED * self.singular_values))

    @property
    def n_null_directions(self) -> int:
        """Combinations of parameters that change no output at all near the point, whatever is measured."""
        return len(self._null_ranks)

    @property
    def _null_ranks(self) -> list[int]:
        are_none = np.flatnonzero(self.singular_values <= self.null * self.singular_values[0])
        # What could not be moved has no slope, but is not known to change nothing.
        unknown = np.sum(self.directions[:, self.is_unknown] ** 2, axis=1)
        return [int(rank) for rank in are_none if unknown[rank] < 0.5]

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """Pairs that the data cannot distinguish: the directions left open that two parameters make up."""
        found = []
        for direction in self.directions[self.n_determined_directions :][::-1]:
            i, j = np.argsort(-(direction**2))[:2] if len(direction) > 1 else (0, 0)
            share = float(direction[i] ** 2 + direction[j] ** 2)
            # Both must matter: a parameter alone that moves nothing compensates none.
            if i != j and share >= A_PAIR and abs(direction[j]) >= 0.5 * abs(direction[i]):
                first, second = sorted((int(i), int(j)))
                sign = 1.0 if direction[first] * direction[second] > 0 else -1.0
                found.append(Pair(self.names[first], self.names[second], sign * share))
        return tuple(found)

    def direction_in_words(self, rank: int) -> str:
        """Say which parameters a direction moves, e.g. "+0.71 cExt1 −0.70 rExt2"."""
        direction = self.directions[rank]
        most = np.argsort(-np.abs(direction))
        terms = [f"{direction[i]:+.2f} {self.names[i]}" for i in most if abs(direction[i]) >= 0.1]
        return " ".join(terms).replace("-", "\N{MINUS SIGN}")

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON values."""
        return {
            "theta": dict(zip(self.names, self.theta.tolist(), strict=True)),
            "mse": self.mse,
            "on_bound": [n for n, on in zip(self.names, self.on_bound, strict=True) if on],
            "determined": list(self.determined),
            "not_determined": [n for n in self.names if n not in self.determined],
            "n_determined_directions": self.n_determined_directions,
            "spread": dict(zip(self.names, self.spread.tolist(), strict=True)),
            "singular_values": self.singular_values.tolist(),
            "n_null_directions": self.n_null_directions,
            "noise": self.noise,
            "null_directions": [self.direction_in_words(k) for k in self._null_ranks],
            "directions": [self.direction_in_words(k) for k in range(len(self.names))],
            "pairs": [pair.to_dict() for pair in self.pairs],
            "n_samples": self.n_samples,
            "n_independent": self.n_independent,
            "n_calls": self.n_calls,
        }


def identifiability(model: ForwardModel, measurement: Measurement, theta: FloatArray) -> Identifiability:
    """Differentiate the residuals at a point and read off what they determine.

    Args:
        model: The physical model.
        measurement: What it is compared with.
        theta: The point. Shape (p,). [per parameter]

    Returns:
        Singular values, correlations and spreads; a parameter that fails on both sides moves nothing.

    Raises:
        InputError: The model fails at the point.
    """
    counter = CountingModel(model)
    problem = CalibrationProblem(counter, measurement)
    u = np.clip(problem.space.to_unit(theta), 0.0, 1.0)
    answer = problem.evaluate(difference_rows(u, STEP))
    if answer.failures[0]:
        raise InputError(f"nothing is known of the model around a point that fails: {answer.failures[0]}")
    noise = noise_of("correlated", measurement, answer.y[0], len(u))
    found = judged(problem.space.names, answer, noise.raised, noise.n_independent, STEP)
    return replace(found, theta=np.array(theta, dtype=np.float64))


def difference_rows(u: FloatArray, step: float) -> FloatArray:
    """Return a point, then one row per parameter moved up, then one per parameter moved down.

    Args:
        u: The point in the unit cube. Shape (p,). [1]
        step: How far; a bound cuts it. [1]

    Returns:
        Shape (2 p + 1, p). [1]
    """
    ahead, behind = np.minimum(u + step, 1.0), np.maximum(u - step, 0.0)
    return np.concatenate([u[None], _moved(u, ahead), _moved(u, behind)])


def judged(
    names: tuple[str, ...],
    answer: Evaluation,
    raised: float,
    n_independent: float,
    step: float,
    *,
    prior: Prior | None = None,
) -> Identifiability:
    """Read off what residuals around a point determine.

    Args:
        names: Names of the p parameters.
        answer: The model at `difference_rows`.
        raised: Noise, raised for residuals that follow each other; above 0. [first output's unit]
        n_independent: Independent samples that the residuals are worth.
        step: The step of the differences. [1]
        prior: What is known beforehand, or None.
    """
    p = answer.u.shape[1]
    found = judged_slopes(
        names, answer.u[0], _slopes(answer).T, raised, null=max(NULL, NULL_PER_STEP * step), prior=prior
    )
    return replace(
        found,
        theta=answer.theta[0],
        mse=float(answer.mse[0]),
        n_samples=answer.residuals.shape[1],
        n_independent=n_independent,
        n_calls=len(answer.u),
        is_unknown=np.array([all(answer.failures[row] for row in (j + 1, j + 1 + p)) for j in range(p)]),
    )


def judged_slopes(
    names: tuple[str, ...],
    u: FloatArray,
    jacobian: FloatArray,
    raised: float,
    *,
    null: float = NULL,
    prior: Prior | None = None,
) -> Identifiability:
    """Read off what slopes of residuals at a point determine, however these are known.

    Args:
        names: Names of the p parameters.
        u: The point. Shape (p,). [1]
        jacobian: The slopes, in any orthonormal basis of the residuals. Shape (m, p).
            [first output's unit per range]
        raised: Noise, raised for residuals that follow each other; above 0. [first output's unit]
        null: Share of the largest singular value below which the others are none. [1]
        prior: What is known beforehand, or None.

    Returns:
        All but the point as parameters, its error and where the slopes come from, which are left empty.
    """
    p = len(u)
    _, values, directions = np.linalg.svd(jacobian, full_matrices=len(jacobian) < p)
    values = np.pad(values, (0, p - len(values)))
    covariance = (directions.T / ((values / raised) ** 2 + 1.0 / BOX_VARIANCE)) @ directions
    known = np.full(p, 1.0 / BOX_VARIANCE)
    if prior is not None:
        known = known + prior.width**-2.0
        covariance = np.linalg.inv(np.linalg.inv(covariance) + np.diag(prior.width**-2.0))
    return Identifiability(
        names=names,
        theta=np.full(p, np.nan),
        mse=np.nan,
        on_bound=(u < ON_BOUND) | (u > 1.0 - ON_BOUND),
        singular_values=values,
        directions=directions,
        noise=raised,
        spread=np.sqrt(np.diag(covariance)),
        before=1.0 / np.sqrt(known),
        correlation=_normed(covariance, np.sqrt(np.diag(covariance))),
        n_samples=len(jacobian),
        n_independent=float(len(jacobian)),
        n_calls=0,
        is_unknown=np.zeros(p, dtype=np.bool_),
        null=null,
    )


def _moved(u: FloatArray, to: FloatArray) -> FloatArray:
    """Return a row per parameter in which that one alone has moved. Shape (p, p)."""
    rows = np.tile(u, (len(u), 1))
    np.fill_diagonal(rows, to)
    return rows


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
        is_good: BoolArray = np.all(np.isfinite(residuals), axis=1)
        there = np.where(is_good, np.diag(answer.u[side]), u)
        ends.append((there, np.where(is_good[:, None], residuals, answer.residuals[0])))
    (ahead, above), (behind, below) = ends
    width = np.where(ahead > behind, ahead - behind, 1.0)
    slopes: FloatArray = (above - below) / width[:, None]
    return slopes


def _normed(products: FloatArray, lengths: FloatArray) -> FloatArray:
    safe = np.where(lengths > 0.0, lengths, 1.0)
    normed: FloatArray = np.clip(products / np.outer(safe, safe), -1.0, 1.0)
    return normed
