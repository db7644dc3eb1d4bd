"""A sample of a density that costs little, wherever in the unit cube its mass lies: tempered particles.

Sequential Monte Carlo (Del Moral, Doucet and Jasra, doi:10.1111/j.1467-9868.2006.00553.x): particles fill the
cube evenly, the density's power rises from 0 to 1 in steps that keep their worth, those in places of little
mass die out, and Markov steps move the rest: a narrow bent valley is filled while it is still wide. Regions
that lie far apart keep their shares if they are about as wide; a much narrower one is kept if it is known.

A step is a multiple of the difference between two other particles (differential evolution Markov chain, ter
Braak, doi:10.1007/s11222-006-8769-1): so steps have the shape of the density. The particles are parted in two
halves, and each moves by differences of the other. They move in normal scores, Phi^-1(u), where an even
density is a normal one and no step leads out of the cube, however many parameters the data leave open.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtr, ndtri

from simulation.arrays import FloatArray, IntArray
from studies.calibration.uncertainty.weights import effective_size, normalized

LEAST_SHARE = 0.6
"""The power rises until the particles are worth this share of their number."""

# As many steps as forget the start took three times the time for the same errors (docs/notes/uncertainty.md).
SWEEPS, LAST_SWEEPS = 10, 30
"""Steps of every particle at each power, and at the last one; more by one and three for each parameter."""

# 2.38 / sqrt(2 p) is the best step where the density is normal (ter Braak 2006).
# Steps as long as a difference, or of a part of the parameters, brought no gain (docs/notes/uncertainty.md).
STEP_SCALE, SHORTEST_STEP, LONGEST = 2.38, -1.0, 0.3
"""A step is so many differences over the square root of 2 p, times e to a power drawn between the others."""

EDGE = 1e-12
"""Nearest that a particle begins to the faces of the cube, whose normal scores are infinite."""

# Of 14 parameters one draw in 20,000 once fell inside: three quarters of the time of an assessment.
MOST_DRAWS = 1000
"""Whoever still fell out of the cube then begins anywhere."""

# The loop ends even for a density so narrow that each power rises by next to nothing.
MOST_POWERS = 300
"""After so many the rest is one step."""

Density = Callable[[FloatArray], FloatArray]
"""Logarithm of a density at points, shape (n, p); minus infinity outside its support."""

OnShare = Callable[[float], None]
"""Called with the share of the work that is done."""

LAST_SHARE = 0.3
"""Share of the work that the last power's steps are, about."""


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
        # Also the fallback: a row that no draw below replaces stays where it is.
        u = rng.random((n, p))
        near = np.arange(n // 2 if len(self.centres) else 0)
        for _ in range(MOST_DRAWS):
            if not near.size:
                break
            member = rng.integers(len(self.centres), size=near.size)
            step = np.einsum("nij,nj->ni", self.roots[member], rng.standard_normal((near.size, p)))
            # Drawn again rather than clipped: clipping would heap particles on the faces.
            there = self.centres[member] + step
            inside = np.all((there >= 0.0) & (there <= 1.0), axis=1)
            u[near[inside]] = there[inside]
            near = near[~inside]
        return u

    def log_density(self, u: FloatArray) -> FloatArray:
        """Return the logarithm of the density, but for a constant and what the cube cuts off. Shape (n,)."""
        c, p = self.centres.shape
        if not c:
            return np.zeros(len(u))
        inverse_roots, centres, log_sizes = self._whitened
        # One matrix product serves all centres at once.
        away = (inverse_roots.reshape(c * p, p) @ u.T).reshape(c, p, -1) - centres[:, :, None]
        parts = -0.5 * np.einsum("cpn,cpn->cn", away, away) - log_sizes[:, None]
        # Log-sum-exp: unless the largest part is taken out, exp() underflows far from all centres.
        top = parts.max(axis=0)
        near = top + np.log(np.mean(np.exp(parts - top), axis=0)) - 0.5 * p * np.log(2.0 * np.pi)
        # The even half has density 1 in the cube, so logarithm 0; both halves weigh the same.
        found: FloatArray = np.logaddexp(0.0, near)
        return found

    @cached_property
    def _whitened(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Inverses of the roots, the centres in their coordinates, logarithms of the determinants."""
        inverse_roots = np.asarray(np.linalg.inv(self.roots), dtype=np.float64)
        centres = np.einsum("cij,cj->ci", inverse_roots, self.centres)
        return inverse_roots, centres, np.sum(np.log(np.diagonal(self.roots, axis1=1, axis2=2)), axis=1)


def sample_density(
    log_density: Density,
    reference: Reference,
    *,
    seed: int,
    n_particles: int,
    on_share: OnShare = lambda share: None,
) -> FloatArray:
    """Sample a density over the unit cube.

    With one BLAS thread it is five times faster: matrices have a hundred rows.

    Args:
        log_density: The density; the cube's outside is never asked.
        reference: Where the particles begin.
        seed: Seed of all draws.
        n_particles: How many.
        on_share: Called with the share of the work that is done.

    Returns:
        Points of equal weight, in no order. Shape (n, p). [1]
    """
    return _Annealing(log_density, reference, n_particles, np.random.default_rng(seed)).run(on_share)


class _Annealing:
    """The particles on their way.

    A cloud has a row per particle: p normal scores, the density's logarithm and the reference's.
    """

    def __init__(
        self, log_density: Density, reference: Reference, n_particles: int, rng: np.random.Generator
    ) -> None:
        self._log_density, self._reference, self._rng = log_density, reference, rng
        self._power = 0.0
        self._cloud = self._at(ndtri(np.clip(reference.draw(n_particles, rng), EDGE, 1.0 - EDGE)))

    def run(self, on_share: OnShare) -> FloatArray:
        """Raise the power to 1."""
        n_powers = 0
        n_parameters = self._cloud.shape[1] - 2
        while self._power < 1.0:
            power = self._next_power() if n_powers < MOST_POWERS else 1.0
            # Before the power is set: weights are the ratio of the new density to the old one.
            # Resampled at every power, so no weights are carried on.
            self._cloud = self._cloud[_drawn(self._weights(power), self._rng)]
            self._power = power
            n_powers += 1
            n_sweeps = LAST_SWEEPS + 3 * n_parameters if power == 1.0 else SWEEPS + n_parameters
            for sweep in range(n_sweeps):
                last = sweep / n_sweeps if power == 1.0 else 0.0
                on_share((1.0 - LAST_SHARE) * power + LAST_SHARE * last)
                self._sweep()
        # Resampling leaves copies side by side, and a sample takes its members from the front.
        return ndtr(self._cloud[self._rng.permutation(len(self._cloud)), :-2])

    def _at(self, z: FloatArray) -> FloatArray:
        """Ask what is known of points; the reference no longer where it does not count."""
        u = ndtr(z)
        # At power 1 its weight is 0, and the last sweeps are the most.
        at_first = np.zeros(len(u)) if self._power == 1.0 else self._reference.log_density(u)
        return np.column_stack([z, self._log_density(u), at_first])

    def _weights(self, power: float) -> FloatArray:
        """Return what the particles count at a higher power. Shape (n,)."""
        # The normal factor of the scores is in both densities and cancels.
        return normalized((power - self._power) * (self._cloud[:, -2] - self._cloud[:, -1]))

    def _next_power(self) -> float:
        """Return the power at which the particles are worth as much as wanted, by halving."""

        def worth(power: float) -> float:
            return effective_size(self._weights(power)) / len(self._cloud)

        # Exactly 1, which a sum of the power and what is left might miss by rounding.
        if worth(1.0) >= LEAST_SHARE:
            return 1.0
        low, high = 0.0, 1.0 - self._power
        # 60 halvings exhaust the 53 bits of a double.
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if worth(self._power + middle) >= LEAST_SHARE else (low, middle)
        # The upper end is above 0 whatever the worth, so the power always rises.
        return min(self._power + high, 1.0)

    def _sweep(self) -> None:
        """Move either half of the particles by differences of the other."""
        # Differences come from particles at rest: of moving ones they would break detailed balance.
        order = self._rng.permutation(len(self._cloud))
        first, second = order[: len(order) // 2], order[len(order) // 2 :]
        self._move(first, second)
        self._move(second, first)

    def _move(self, rows: IntArray, others: IntArray) -> None:
        here = self._cloud[rows]
        n, p = len(rows), here.shape[1] - 2
        # The two may be the same particle: that step has no length and does no harm.
        one, two = others[self._rng.integers(len(others), size=(2, n))]
        length = STEP_SCALE / np.sqrt(2.0 * p) * np.exp(self._rng.uniform(SHORTEST_STEP, LONGEST, (n, 1)))
        difference = self._cloud[one, :-2] - self._cloud[two, :-2]
        there = self._at(here[:, :-2] + length * difference)
        # Metropolis rule without a correction: a difference and its reverse are equally probable.
        gain = self._between(there) - self._between(here)
        taken = np.flatnonzero(np.log(self._rng.random(n)) < gain)
        self._cloud[rows[taken]] = there[taken]

    def _between(self, cloud: FloatArray) -> FloatArray:
        """Return the logarithm of the density between the first and the last one, in normal scores."""
        # A geometric path: at power 1 the reference is gone, and with it what its density leaves out.
        between = self._power * cloud[:, -2] + (1.0 - self._power) * cloud[:, -1]
        # Change of variables u = Phi(z): the density in z is that in u times the normal density.
        found: FloatArray = between - 0.5 * np.sum(cloud[:, :-2] ** 2, axis=1)
        return found


def _drawn(weights: FloatArray, rng: np.random.Generator) -> IntArray:
    """Draw members by their weights, as evenly as can be. Shape (n,)."""
    n = len(weights)
    # Systematic resampling (Kitagawa 1996): by one random number, so copies differ from n w by less than 1.
    at = (np.arange(n) + rng.random()) / n
    # Rounding may leave the sum of all weights just below the last position.
    return np.minimum(np.searchsorted(np.cumsum(weights), at), n - 1)
