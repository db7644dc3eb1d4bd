"""A sample of a density that costs little, wherever in the unit cube its mass lies: tempered particles.

Sequential Monte Carlo (Del Moral, Doucet and Jasra, doi:10.1111/j.1467-9868.2006.00553.x): particles fill the
cube evenly, the density's power rises from 0 to 1 in steps that keep their worth, those in places of little
mass die out, and Markov steps move the rest: a narrow bent valley is filled while it is still wide. Regions
that lie far apart keep their shares if they are about as wide; a much narrower one is kept if it is known.

Steps take their shape from the place where they begin: the particles are parted in two halves, and around
each member of the one its nearest fellows tell a covariance. A particle of the other half steps by that of
its nearest member, or leaps into the normal density around any of them; the way back is weighed against it.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray, IntArray
from studies.uncertainty.weights import effective_size, normalized

WORTH = 0.6
"""The power rises until the particles are worth this share of their number."""

SWEEPS, LAST_SWEEPS = 3, 12
"""Steps of every particle at each power, and at the last one; every third is a leap."""

ACCEPTED = 0.25
"""Share of steps that shall be taken: their width follows it."""

NEIGHBOURS_PER_PARAMETER = 3
"""Nearest fellows that tell a covariance, for each parameter and two more."""

LEAST_WIDTH = 1e-6
"""Standard deviation that a covariance has at least. [1]"""

MOST_DRAWS = 1000
"""Whoever still fell out of the cube then begins anywhere."""

MOST_POWERS = 300
"""After so many the rest is one step."""

Density = Callable[[FloatArray], FloatArray]
"""Logarithm of a density at points, shape (n, p); minus infinity outside its support."""


@dataclass(frozen=True, eq=False)
class Particles:
    """A sample of a density.

    Attributes:
        u: Points of equal weight, in no order. Shape (n, p). [1]
        log_density: Their density's logarithm. Shape (n,). [1]
        n_powers: Steps from an even density to this one.
        acceptance: Share of the last power's steps that were taken. [1]
    """

    u: FloatArray
    log_density: FloatArray
    n_powers: int
    acceptance: float


@dataclass(frozen=True, eq=False)
class Reference:
    """Where particles begin: half of them anywhere in the cube, half near places that are known to be good.

    A place that is good, but so narrow that an even start would hardly hit it, is not lost then.

    Attributes:
        centres: Shape (c, p). [1]
        roots: Lower factors of the covariances around them. Shape (c, p, p). [1]
    """

    centres: FloatArray
    roots: FloatArray

    @classmethod
    def even(cls, n_parameters: int) -> "Reference":
        """Return the one that knows no good place."""
        return cls(np.empty((0, n_parameters)), np.empty((0, n_parameters, n_parameters)))

    def draw(self, n: int, rng: np.random.Generator) -> FloatArray:
        """Draw points inside the cube. Shape (n, p). [1]."""
        p = self.centres.shape[1]
        u = rng.random((n, p))
        near = np.arange(n // 2 if len(self.centres) else 0)
        for _ in range(MOST_DRAWS):
            if not near.size:
                break
            member = rng.integers(len(self.centres), size=near.size)
            step = np.einsum("nij,nj->ni", self.roots[member], rng.standard_normal((near.size, p)))
            there = self.centres[member] + step
            inside = np.all((there >= 0.0) & (there <= 1.0), axis=1)
            u[near[inside]] = there[inside]
            near = near[~inside]
        return u

    def log_density(self, u: FloatArray) -> FloatArray:
        """Return the logarithm of the density, but for a constant and what the cube cuts off. Shape (n,)."""
        if not len(self.centres):
            return np.zeros(len(u))
        mixture = Mixture(self.centres, self.roots)
        near = mixture.log_density(u) - 0.5 * u.shape[1] * np.log(2.0 * np.pi) - np.log(len(self.centres))
        found: FloatArray = np.logaddexp(0.0, near)
        return found


def sample_density(log_density: Density, reference: Reference, *, seed: int, n_particles: int) -> Particles:
    """Sample a density over the unit cube.

    Args:
        log_density: The density; the cube's outside is never asked.
        reference: Where the particles begin.
        seed: Seed of all draws.
        n_particles: How many.
    """
    with threadpool_limits(limits=1, user_api="blas"):
        return _Annealing(log_density, reference, n_particles, np.random.default_rng(seed)).run()


class _Annealing:
    """The particles on their way."""

    def __init__(
        self, log_density: Density, reference: Reference, n_particles: int, rng: np.random.Generator
    ) -> None:
        self._log_density, self._reference, self._rng = log_density, reference, rng
        self._u = reference.draw(n_particles, rng)
        self._value, self._at_first = log_density(self._u), reference.log_density(self._u)
        self._power = 0.0
        self._step = 2.38 / np.sqrt(self._u.shape[1])

    def run(self) -> Particles:
        """Raise the power to 1."""
        n_powers, taken = 0, 0.0
        while self._power < 1.0:
            power = self._next_power() if n_powers < MOST_POWERS else 1.0
            drawn = _drawn(self._weights(power), self._rng)
            self._u, self._value, self._at_first = self._u[drawn], self._value[drawn], self._at_first[drawn]
            self._power = power
            n_powers += 1
            n_sweeps = LAST_SWEEPS if power == 1.0 else SWEEPS
            taken = float(np.mean([self._sweep(leaps=i % 3 == 2) for i in range(n_sweeps)]))
        order = self._rng.permutation(len(self._u))
        return Particles(self._u[order], self._value[order], n_powers, taken)

    def _weights(self, power: float) -> FloatArray:
        """Return what the particles count at a higher power. Shape (n,)."""
        return normalized((power - self._power) * (self._value - self._at_first))

    def _next_power(self) -> float:
        """Return the power at which the particles are worth as much as wanted, by halving."""

        def worth(power: float) -> float:
            return effective_size(self._weights(power)) / len(self._value)

        if worth(1.0) >= WORTH:
            return 1.0
        low, high = 0.0, 1.0 - self._power
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if worth(self._power + middle) >= WORTH else (low, middle)
        return min(self._power + high, 1.0)

    def _sweep(self, *, leaps: bool) -> float:
        """Move either half of the particles by the other one; return the share of steps taken."""
        order = self._rng.permutation(len(self._u))
        middle = len(order) // 2
        taken = [
            self._move(moved, _Guide(self._u[still]), leaps=leaps)
            for moved, still in ((order[:middle], order[middle:]), (order[middle:], order[:middle]))
        ]
        return float(np.mean(taken))

    def _move(self, rows: IntArray, guide: "_Guide", *, leaps: bool) -> float:
        here, value, at_first = self._u[rows], self._value[rows], self._at_first[rows]
        n, p = here.shape
        drawn = self._rng.standard_normal((n, p))
        if leaps:
            member = np.asarray(self._rng.integers(len(guide.u), size=n), dtype=np.int64)
            there = guide.u[member] + np.einsum("nij,nj->ni", guide.roots[member], drawn)
            back_over_there = guide.mixture.log_density(here) - guide.mixture.log_density(there)
        else:
            scale = self._step * np.exp(self._rng.uniform(-1.0, 0.5, n))
            member = guide.nearest(here)
            step = scale[:, None] * np.einsum("nij,nj->ni", guide.roots[member], drawn)
            there = here + step
            back = guide.mixture.log_step(guide.nearest(there), step / scale[:, None])
            back_over_there = back - guide.mixture.log_step(member, step / scale[:, None])
        inside = np.all((there >= 0.0) & (there <= 1.0), axis=1)
        found, first_there = np.full(n, -np.inf), np.zeros(n)
        found[inside] = self._log_density(there[inside])
        first_there[inside] = self._reference.log_density(there[inside])
        gain = self._power * (found - value) + (1.0 - self._power) * (first_there - at_first)
        gain += back_over_there
        accepted = np.log(self._rng.random(n)) < gain
        self._u[rows[accepted]], self._value[rows[accepted]] = there[accepted], found[accepted]
        self._at_first[rows[accepted]] = first_there[accepted]
        share = float(np.mean(accepted))
        if not leaps:
            self._step *= float(np.exp(0.5 * (share - ACCEPTED)))
        return share


class Mixture:
    """Normal densities of equal weight around points."""

    def __init__(self, u: FloatArray, roots: FloatArray) -> None:
        """Prepare what does not depend on where the density is asked.

        Args:
            u: The points. Shape (m, p). [1]
            roots: Lower factors of the covariances around them. Shape (m, p, p). [1]
        """
        self._inverse_roots = np.linalg.inv(roots)
        self._centres = np.einsum("mij,mj->mi", self._inverse_roots, u)
        self._log_sizes = np.sum(np.log(np.diagonal(roots, axis1=1, axis2=2)), axis=1)

    def log_density(self, u: FloatArray) -> FloatArray:
        """Return the logarithm of the sum of all members' densities, but for 2 pi. Shape (n,)."""
        m, p = self._centres.shape
        away = (self._inverse_roots.reshape(m * p, p) @ u.T).reshape(m, p, -1) - self._centres[:, :, None]
        parts = -0.5 * np.einsum("mpn,mpn->mn", away, away) - self._log_sizes[:, None]
        top = parts.max(axis=0)
        found: FloatArray = top + np.log(np.sum(np.exp(parts - top), axis=0))
        return found

    def log_step(self, member: IntArray, step: FloatArray) -> FloatArray:
        """Return the logarithm of a member's density of a step, but for 2 pi. Shape (n,)."""
        away = np.einsum("nij,nj->ni", self._inverse_roots[member], step)
        found: FloatArray = -0.5 * np.sum(away**2, axis=1) - self._log_sizes[member]
        return found


class _Guide:
    """Particles that stand still and show the others how the density lies.

    Attributes:
        u: Their places. Shape (m, p). [1]
        roots: Lower factors of the covariances around them. Shape (m, p, p). [1]
        mixture: The normal densities around them.
    """

    def __init__(self, u: FloatArray) -> None:
        """Find everybody's nearest fellows."""
        n, p = u.shape
        floor = LEAST_WIDTH**2 * np.eye(p)
        self._whitener = np.linalg.inv(np.linalg.cholesky(np.cov(u.T).reshape(p, p) + floor)).T
        self._white = u @ self._whitener
        k = min(NEIGHBOURS_PER_PARAMETER * (p + 2), n)
        fellows = np.argpartition(_squares(self._white, self._white), k - 1, axis=1)[:, :k]
        away = u[fellows] - u[fellows].mean(axis=1, keepdims=True)
        covariance = np.einsum("nki,nkj->nij", away, away, optimize=True) / (k - 1)
        self.u, self.roots = u, np.linalg.cholesky(covariance + floor)
        self.mixture = Mixture(u, self.roots)

    def nearest(self, u: FloatArray) -> IntArray:
        """Return which member lies nearest to points. Shape (n,)."""
        found: IntArray = np.argmin(_squares(u @ self._whitener, self._white), axis=1)
        return found


def _squares(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the squared distances of points to others. Shape (n, m)."""
    found: FloatArray = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * a @ b.T
    return found


def _drawn(weights: FloatArray, rng: np.random.Generator) -> IntArray:
    """Draw members by their weights, as evenly as can be. Shape (n,)."""
    n = len(weights)
    at = (np.arange(n) + rng.random()) / n
    found: IntArray = np.minimum(np.searchsorted(np.cumsum(weights), at), n - 1)
    return found
