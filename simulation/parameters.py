"""Physical parameters: bounds, units, scales, and the map between the box and the unit cube."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.errors import InputError

Scale = Literal["linear", "log"]
_ROUNDING = 1e-12
"""Share by which a sum may be above its limit: its last term was solved for."""


@dataclass(frozen=True)
class Belief:
    """What is known about a parameter before it is calibrated: it is normal in the parameter's coordinates.

    Attributes:
        centre: Most probable value, inside the bounds. [unit]
        deviation: Standard deviation; for a logarithmic parameter the factor that two thirds of the
            probability lie within (geometric standard deviation), above 1. [unit, or 1]
    """

    centre: float
    deviation: float


@dataclass(frozen=True)
class Parameter:
    """A physical parameter to calibrate.

    Attributes:
        name: Name of the variable in the model.
        lower: Lower bound. [unit]
        upper: Upper bound, above the lower one. [unit]
        estimate: Expert's estimate inside the bounds, or None. [unit]
        unit: Unit as the model writes it.
        scale: Coordinates in which the unit cube is even; "log" needs positive bounds.
        description: What the parameter means.
        prior: What is known about it beforehand, or None.
    """

    name: str
    lower: float
    upper: float
    estimate: float | None = None
    unit: str = "1"
    scale: Scale = "linear"
    description: str = ""
    prior: Belief | None = None

    def __post_init__(self) -> None:
        where = f"parameter {self.name}"
        if not (math.isfinite(self.lower) and math.isfinite(self.upper)):
            raise InputError(
                f"{where}: bounds {self.lower:g} to {self.upper:g} are not finite; give two numbers"
            )
        if self.lower >= self.upper:
            raise InputError(
                f"{where}: lower = {self.lower:g} is not below upper = {self.upper:g}; swap or widen them"
            )
        if self.scale not in ("linear", "log"):
            raise InputError(f'{where}: scale = "{self.scale}" is unknown; use "linear" or "log"')
        if self.scale == "log" and self.lower <= 0:
            raise InputError(
                f'{where}: scale = "log" needs positive bounds, lower is {self.lower:g}; '
                'raise it above 0 or use scale = "linear"'
            )
        if self.estimate is not None and not self.lower <= self.estimate <= self.upper:
            raise InputError(
                f"{where}: estimate = {self.estimate:g} lies outside the bounds {self.lower:g} to "
                f"{self.upper:g}; move the estimate or widen the bounds"
            )
        if self.prior is not None:
            self._check(self.prior)

    def _check(self, prior: Belief) -> None:
        where = f"parameter {self.name}: prior"
        if not self.lower <= prior.centre <= self.upper:
            raise InputError(
                f"{where}: about = {prior.centre:g} lies outside the bounds {self.lower:g} to "
                f"{self.upper:g}; move it or widen the bounds"
            )
        if self.scale == "log" and not 1.0 < prior.deviation < math.inf:
            raise InputError(f"{where}: within_factor = {prior.deviation:g}; give a number above 1, like 1.5")
        if not 0.0 < prior.deviation < math.inf:
            raise InputError(f"{where}: within = {prior.deviation:g}; give a number above 0")


class SumLimit(NamedTuple):
    """A weighted sum of parameters that stays at or below a number.

    Attributes:
        terms: Names and weights, in the order of the parameters.
        most: The number. [the parameters' unit]
    """

    terms: tuple[tuple[str, float], ...]
    most: float


@dataclass(frozen=True)
class ParameterSpace:
    """The box of all parameters of a case, in a fixed order.

    With constraints it is the part of the box that keeps them. The unit cube is then mapped onto that part,
    so that whatever moves in the cube keeps them: the larger one of a pair has its cube's edge between the
    smaller one and its upper bound.

    Attributes:
        parameters: The parameters.
        constraints: Pairs of names: the first one's value stays at or below the second one's.
        sums: Sums that stay below a number. No parameter is in two of them, or in a pair as well.
    """

    parameters: tuple[Parameter, ...]
    constraints: tuple[tuple[str, str], ...] = ()
    sums: tuple[SumLimit, ...] = ()

    def __post_init__(self) -> None:
        if not self.parameters:
            raise InputError("no parameter is declared; declare at least one to calibrate")
        for name in self.names:
            if self.names.count(name) > 1:
                raise InputError(f"parameter {name} is declared {self.names.count(name)} times; keep one")

    @cached_property
    def expected(self) -> FloatArray:
        """Estimates, and the middle of the box where there is none. Shape (p,). [per parameter]."""
        estimates = np.array([one.estimate for one in self.parameters], dtype=np.float64)  # NaN for None
        theta = np.where(np.isnan(estimates), self.from_unit(np.full(self.n_parameters, 0.5)), estimates)
        for small, large in self._pairs:
            if np.isnan(estimates[large]):
                theta[large] = max(theta[large], theta[small])
            elif np.isnan(estimates[small]):
                theta[small] = min(theta[small], theta[large])
        if self.sums and not self.contains(theta):
            theta = self.from_unit(self.to_unit(theta))
        return theta

    @property
    def is_bent(self) -> bool:
        """Whether constraints make the cube's edges depend on each other."""
        return bool(self.constraints or self.sums)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names in the order of the columns of theta."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def n_parameters(self) -> int:
        """Number of parameters p."""
        return len(self.parameters)

    @cached_property
    def lower(self) -> FloatArray:
        """Lower bounds. Shape (p,). [per parameter]."""
        return _read_only([parameter.lower for parameter in self.parameters])

    @cached_property
    def upper(self) -> FloatArray:
        """Upper bounds. Shape (p,). [per parameter]."""
        return _read_only([parameter.upper for parameter in self.parameters])

    @cached_property
    def is_log(self) -> BoolArray:
        """Which parameters have logarithmic coordinates. Shape (p,)."""
        mask = np.array([parameter.scale == "log" for parameter in self.parameters])
        mask.setflags(write=False)
        return mask

    def rows(self, theta: FloatArray) -> FloatArray:
        """Return a copy of what a model is asked, as doubles. Shape (n, p). [per parameter].

        Raises:
            ValueError: If it has another shape.
        """
        theta = np.array(theta, dtype=np.float64)
        if theta.ndim != 2 or theta.shape[1] != self.n_parameters:
            raise ValueError(f"theta has shape {theta.shape}; expected (n, {self.n_parameters})")
        return theta

    def named(self, values: FloatArray) -> dict[str, float]:
        """Return values by the parameters' names. Shape (p,)."""
        return dict(zip(self.names, values.tolist(), strict=True))

    @cached_property
    def _pairs(self) -> tuple[tuple[int, int], ...]:
        """Columns of the constraints, so ordered that each smaller one is known before its larger one."""
        left = [(self.names.index(small), self.names.index(large)) for small, large in self.constraints]
        pairs = list[tuple[int, int]]()
        while left:
            larger = {large for _, large in left}
            ready = [pair for pair in left if pair[0] not in larger]
            if not ready:
                raise InputError(f"constraint {self._said(left[0])} contradicts others; drop one")
            pairs += ready
            left = [pair for pair in left if pair not in ready]
        return tuple(pairs)

    @cached_property
    def _sums(self) -> list[tuple[IntArray, FloatArray, float]]:
        """Columns, weights and limit of each sum."""
        return [
            (
                np.array([self.names.index(name) for name, _ in one.terms]),
                np.array([weight for _, weight in one.terms]),
                one.most,
            )
            for one in self.sums
        ]

    @cached_property
    def _reachable(self) -> FloatArray:
        """Lower and upper bounds that constraints leave. Shape (2, p). [per parameter]."""
        lower, upper = self.lower.copy(), self.upper.copy()
        for small, large in self._pairs:
            lower[large] = max(lower[large], lower[small])
        for small, large in self._pairs[::-1]:
            upper[small] = min(upper[small], upper[large])
        for columns, weights, most in self._sums:
            least = np.minimum(weights * lower[columns], weights * upper[columns])
            ends = (most - (least.sum() - least)) / weights
            up = weights > 0.0
            upper[columns[up]] = np.minimum(upper[columns[up]], ends[up])
            lower[columns[~up]] = np.maximum(lower[columns[~up]], ends[~up])
            if np.any(lower[columns] >= upper[columns]):
                names = ", ".join(self.names[column] for column in columns)
                raise InputError(f"constraint on {names}: no values within the bounds keep it; widen them")
        for pair in self._pairs:
            if any(lower[one] >= upper[one] for one in pair):
                raise InputError(
                    f"constraint {self._said(pair)}: no values within the bounds keep it; widen them"
                )
        return np.stack([lower, upper])

    def _said(self, pair: tuple[int, int]) -> str:
        return f'"{self.names[pair[0]]} < {self.names[pair[1]]}"'

    def _bounds(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the ends of the cube's edges at parameters that keep the constraints. Shape as theta."""
        lower, upper = (np.broadcast_to(one, theta.shape).copy() for one in self._reachable)
        for small, large in self._pairs:
            lower[..., large] = np.maximum(lower[..., large], theta[..., small])
        for columns, weights, most in self._sums:
            # Each is limited by those before it, and by the least that those after it can be.
            terms = weights * theta[..., columns]
            least = np.minimum(weights * lower[..., columns], weights * upper[..., columns])
            before, after = np.cumsum(terms, axis=-1) - terms, np.cumsum(least[..., ::-1], axis=-1)[..., ::-1]
            ends = (most - before - (after - least)) / weights
            up = weights > 0.0
            ends = np.clip(ends, lower[..., columns], upper[..., columns])
            upper[..., columns[up]] = ends[..., up]
            lower[..., columns[~up]] = ends[..., ~up]
        return lower, upper

    def to_unit(self, theta: FloatArray) -> FloatArray:
        """Map parameters to the unit cube, even in each parameter's own coordinates.

        Args:
            theta: Parameters. Shape (n, p) or (p,). [per parameter]

        Returns:
            Unit-cube coordinates, exactly 0 and 1 at the bounds. Shape as theta. [1]
        """
        theta = self._checked(theta)
        ends = self._bounds(theta) if self.is_bent else (self.lower, self.upper)
        lower, upper = (self._coordinates(one) for one in ends)
        with np.errstate(invalid="ignore", divide="ignore"):
            u: FloatArray = (self._coordinates(theta) - lower) / (upper - lower)
        if self.is_bent:
            # Where the smaller one is at the upper bound of the larger one, the edge has no length.
            u = np.where((upper == lower) & np.isfinite(theta), 1.0, u)
        return u

    def from_unit(self, u: FloatArray) -> FloatArray:
        """Map unit-cube coordinates to parameters inside the bounds.

        Args:
            u: Unit-cube coordinates; those outside 0 to 1 land on the bound. Shape (n, p) or (p,). [1]

        Returns:
            Parameters, exactly on the bounds at 0 and 1. Shape as u. [per parameter]
        """
        u = self._checked(u)
        if not self.is_bent:
            return self._inside(u, self.lower, self.upper)
        lower, upper = self._reachable
        theta = self._inside(u, lower, upper)
        for _, large in self._pairs:
            # All smaller ones of this one are known by now.
            bounds = self._bounds(theta)
            theta[..., large] = self._inside(u, *bounds)[..., large]
        for columns, _, _ in self._sums:
            for column in columns:
                theta[..., column] = self._inside(u, *self._bounds(theta))[..., column]
        return theta

    def _inside(self, u: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
        """Map coordinates to parameters between bounds of shape (p,) or that of u."""
        low, high = self._coordinates(lower), self._coordinates(upper)
        inside = low + u * (high - low)
        theta = np.where(self.is_log, np.exp(np.where(self.is_log, inside, 0.0)), inside)
        theta = np.where(u <= 0.0, lower, np.where(u >= 1.0, upper, theta))
        # NaN coordinates stay NaN through the clip: a failed row of the model, not a corner of the box.
        return np.clip(theta, lower, upper)

    def ends(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return how far each parameter can be moved while the others stay. Shape (p,) each. [per parameter].

        Args:
            theta: Where they stay. Shape (p,). [per parameter]
        """
        lower, upper = self.lower.copy(), self.upper.copy()
        for small, large in self._pairs:
            lower[large] = max(lower[large], theta[small])
            upper[small] = min(upper[small], theta[large])
        for columns, weights, most in self._sums:
            left = most - float(weights @ theta[columns])
            for column, weight in zip(columns, weights, strict=True):
                end = max(theta[column] + left / weight, lower[column]) if weight > 0 else upper[column]
                upper[column] = min(upper[column], end)
                if weight < 0:
                    lower[column] = max(lower[column], min(theta[column] + left / weight, upper[column]))
        return lower, upper

    def contains(self, theta: FloatArray) -> BoolArray:
        """Return which rows lie inside the bounds (bounds included, NaN outside).

        Args:
            theta: Parameters. Shape (n, p) or (p,). [per parameter]

        Returns:
            One truth value per row. Shape (n,) or ().
        """
        theta = self._checked(theta)
        inside: BoolArray = np.all((theta >= self.lower) & (theta <= self.upper), axis=-1)
        for small, large in self._pairs:
            inside = inside & (theta[..., small] <= theta[..., large])
        for columns, weights, most in self._sums:
            terms = weights * theta[..., columns]
            slack = _ROUNDING * (np.abs(terms).sum(axis=-1) + abs(most))
            inside = inside & (terms.sum(axis=-1) <= most + slack)
        return inside

    def _coordinates(self, theta: FloatArray) -> FloatArray:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.where(self.is_log, np.log(np.where(self.is_log, theta, 1.0)), theta)

    def _checked(self, array: FloatArray) -> FloatArray:
        array = np.asarray(array, dtype=np.float64)
        if array.ndim not in (1, 2) or array.shape[-1] != self.n_parameters:
            raise ValueError(
                f"expected shape (n, {self.n_parameters}) or ({self.n_parameters},), got {array.shape}"
            )
        return array


def _read_only(values: list[float]) -> FloatArray:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
