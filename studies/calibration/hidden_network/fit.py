"""Fit a hidden network to simulated rows: damped Gauss-Newton steps over all constants and powers.

Few powers differ from zero, so each costs the logarithm of its size (reweighted as in Candès, Wakin and Boyd
2008, doi:10.1007/s00041-008-9045-x). What the rows weigh grows while the misfit falls, so that the powers
that matter most are found first.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from pelsvae.linear_network.form import UNITS
from simulation.arrays import FloatArray
from studies.calibration.hidden_network.model import Network, NetworkForm

# Neighbouring samples of a trajectory are alike: so many count as one.
N_ALIKE = 40.0
# A power costs this times the logarithm of its square, beside the square of a width that falls from the first
# to the last by a factor per step.
COST, WIDE, NARROW, NARROWER = 2.0, 0.5, 0.1, 0.965
# The scaled misfit that rows are weighed by, at first and at least, and by how much it falls in a step.
FIRST_NOISE, LEAST_NOISE, NOISE_FALL = 5.0, 1e-7, 0.7
# Damping as is usual for Levenberg-Marquardt; by hand.
DAMPING, EASIEST, EASIER, STIFFER = 1.0, 1e-9, 0.2, 2.0
N_TRIALS = 10  # attempts of a step
# Steps of a constant beyond which a step is shortened, and part of a step at which its bend is measured.
LONGEST_STEP, PART = 3.0, 0.1
# A step bends too much where its correction is this part of it (Transtrum and Sethna 2012, arXiv:1201.5885).
BENT = 0.75
# A fit ends after so many steps in a row that gain less than this in the logarithm of the probability.
LITTLE_PROBABLE, N_LITTLE_STEPS = 0.1, 3


@dataclass(frozen=True, eq=False)
class Fit:
    """A network and how it was fitted.

    Attributes:
        network: The network.
        misfit: Root mean square of scaled outputs minus simulated ones. [1]
        width: Width of the cost of powers. [1]
        noise: What rows are weighed by. [1]
    """

    network: Network
    misfit: float = np.inf
    width: float = WIDE
    noise: float = FIRST_NOISE


def first_guess(network: Network, rng: np.random.Generator) -> Fit:
    """Return where a fit begins: near what is most probable beforehand.

    Args:
        network: A network of the form.
        rng: Source of the differences.
    """
    form = network.form
    weights = form.mean.copy()
    n = form.n_elements
    weights[:n, 0] += rng.normal(0.0, 0.7, n)
    weights[:n, 1:] += rng.normal(0.0, 0.02, (n, weights.shape[1] - 1)) * form.is_free[:n, 1:]
    return Fit(replace(network, weights=weights))


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows that a network is fitted to.

    Attributes:
        features: Of their points. Shape (n, 1 + p).
        target: Their scaled outputs. Shape (n, t, k).
        root: Roots of how much they count. Shape (n, 1).
    """

    features: FloatArray
    target: FloatArray
    root: FloatArray

    def misfit(self, network: Network) -> FloatArray:
        """Return scaled outputs of a network minus simulated ones. Shape (n, t k)."""
        return self._misfit(network.solved(self.features, with_slopes=False)[0])

    def linearised(self, network: Network) -> tuple[FloatArray, FloatArray]:
        """Return the misfit and its slopes by the rows' elements. Shapes (n, t k), (n, t k, q + s)."""
        solved, slopes = network.solved(self.features, with_slopes=True)
        return self._misfit(solved), self.root[:, :, None] * slopes

    def size(self, misfit: FloatArray) -> float:
        """Return a misfit's root mean square."""
        return float(np.sqrt(np.square(misfit).sum() / (np.square(self.root).sum() * self.target[0].size)))

    def _misfit(self, solved: FloatArray) -> FloatArray:
        return np.asarray(self.root * (solved - self.target).reshape(len(self.root), -1))


@dataclass(frozen=True, eq=False)
class _Quadratic:
    """The cost of powers and misfits around a network.

    Attributes:
        form: The network's form.
        weight: Of the squares of a misfit.
        precision: Of constants and powers. Shape (q + s, 1 + p).
    """

    form: NetworkForm
    weight: float
    precision: FloatArray

    @classmethod
    def around(cls, network: Network, noise: float, width: float) -> Self:
        """Return the cost where rows have a noise and powers a width."""
        precision, n = network.form.precision.copy(), network.form.n_elements
        precision[:n, 1:] = 2.0 * COST / (width**2 + network.weights[:n, 1:] ** 2)
        return cls(network.form, 1.0 / (N_ALIKE * noise**2), precision)

    def value(self, weights: FloatArray, misfit: FloatArray) -> float:
        """Return the cost."""
        known = float((self.precision * (weights - self.form.mean) ** 2).sum())
        known += float(np.square(self._off_units(weights)).sum())
        return 0.5 * (self.weight * float(np.square(misfit).sum()) + known)

    def slope(self, weights: FloatArray, by_weights: FloatArray) -> FloatArray:
        """Return the cost's slopes from those of half the squared misfit. Shape (q + s, 1 + p)."""
        slope = self.weight * by_weights + self.precision * (weights - self.form.mean)
        slope[: self.form.n_elements] += np.outer(self._off_units(weights), self.form.by_unit) / UNITS
        return slope

    def curvature(self, slopes: FloatArray, features: FloatArray) -> FloatArray:
        """Return the curvature by what is free, without that of the misfits themselves. Shape (f, f)."""
        n_blocks, n_features = self.precision.shape
        products = np.matmul(slopes.transpose(0, 2, 1), slopes).reshape(len(features), -1)
        squares = (features[:, :, None] * features[:, None, :]).reshape(len(features), -1)
        # A slope by a weight is that by its element times its feature.
        whole = self.weight * (products.T @ squares).reshape(n_blocks, n_blocks, n_features, n_features)
        for element in range(self.form.n_elements):
            whole[element, element] += np.outer(self.form.by_unit, self.form.by_unit) / UNITS**2
        free = np.flatnonzero(self.form.is_free)
        found = whole.transpose(0, 2, 1, 3).reshape(n_blocks * n_features, -1)[np.ix_(free, free)]
        found[np.diag_indices(free.size)] += self.precision[self.form.is_free]
        return np.asarray(found)

    def _off_units(self, weights: FloatArray) -> FloatArray:
        """Return how far powers of time are from what units demand, in standard deviations. Shape (q,)."""
        form = self.form
        off: FloatArray = weights[: form.n_elements] @ form.by_unit - form.powers * form.by_unit.any()
        return off / UNITS


def improved(fit: Fit, u: FloatArray, y: FloatArray, share: FloatArray, n_steps: int) -> Fit:
    """Go on fitting.

    Args:
        fit: What is known.
        u: Points of the rows. Shape (n, p). [1]
        y: Their outputs. Shape (n, t, k). [first output's unit]
        share: How much every row counts, at most 1. Shape (n,). [1]
        n_steps: Most steps.
    """
    network, width, noise = fit.network, fit.width, fit.noise
    rows = _Rows(
        network.form.features(u, network.unit), (y - network.level) * network.unit, np.sqrt(share)[:, None]
    )
    damping, n_little = DAMPING, 0
    misfit, slopes = rows.linearised(network)
    for _ in range(n_steps):
        width = max(width * NARROWER, NARROW)
        noise = max(rows.size(misfit), NOISE_FALL * noise, LEAST_NOISE)
        quadratic = _Quadratic.around(network, noise, width)
        found = _step(network, rows, quadratic, misfit, slopes, damping)
        if found is None:
            break
        network, gain, damping = found
        misfit, slopes = rows.linearised(network)
        n_little = n_little + 1 if gain < LITTLE_PROBABLE else 0
        if n_little == N_LITTLE_STEPS:
            break
    return Fit(network, rows.size(misfit), width, noise)


def _step(
    network: Network,
    rows: _Rows,
    quadratic: _Quadratic,
    misfit: FloatArray,
    slopes: FloatArray,
    damping: float,
) -> tuple[Network, float, float] | None:
    """Return the network after a step, what that gains, and the next damping; None where nothing gains."""
    form, weights = network.form, network.weights
    features, is_free = rows.features, form.is_free
    curvature = quadratic.curvature(slopes, features)
    by_weights = np.einsum("rte,rt->re", slopes, misfit).T @ features
    slope, before = quadratic.slope(weights, by_weights)[is_free], quadratic.value(weights, misfit)
    places, harder = np.diag_indices(slope.size), STIFFER
    straight, turn = np.zeros_like(weights), np.zeros_like(weights)
    for _ in range(N_TRIALS):
        damped = curvature.copy()
        damped[places] += damping * form.precision[is_free]
        factor = cho_factor(damped, overwrite_a=True, check_finite=False)
        straight[is_free] = -cho_solve(factor, slope, check_finite=False)
        # The bend of the path, from the second derivative along the step.
        along = np.einsum("rte,re->rt", slopes, features @ straight.T)
        beside = rows.misfit(replace(network, weights=weights + PART * straight))
        bend = 2.0 / PART * ((beside - misfit) / PART - along)
        pull = quadratic.weight * np.einsum("rte,rt->re", slopes, bend).T @ features
        turn[is_free] = -cho_solve(factor, pull[is_free], check_finite=False)
        size, bent = (float((form.precision * one**2).sum()) for one in (straight, turn))
        if bent <= BENT**2 * size:
            step = straight + 0.5 * turn
            step *= min(1.0, LONGEST_STEP / float(np.abs(step[: form.n_elements, 0]).max()))
            after = replace(network, weights=weights + step)
            gain = before - quadratic.value(after.weights, rows.misfit(after))
            if gain > 0.0:
                # Damping follows from how much of the expected gain was found (Nielsen 1999).
                part = min(gain / (-0.5 * float(slope @ straight[is_free])), 1.0)
                return after, gain, max(damping * max(EASIER, 1.0 - (2.0 * part - 1.0) ** 3), EASIEST)
        damping *= harder
        harder *= 1.5
    return None
