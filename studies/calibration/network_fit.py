"""Fit a hidden network to simulated rows: damped Gauss-Newton steps over all constants and powers.

Few powers differ from zero, so each costs the logarithm of its size (reweighted as in Candès, Wakin and Boyd
2008, doi:10.1007/s00041-008-9045-x). What the rows weigh grows while the misfit falls, so that the powers
that matter most are found first.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from simulation.arrays import FloatArray
from studies.calibration.network_model import UNITS, Network

# Neighbouring samples of a trajectory tell the same: so many count as one.
N_ALIKE = 40.0
# A power costs this times the logarithm of its square, beside the square of a width that falls from the first
# to the last by a factor per step.
COST, WIDE, NARROW, NARROWER = 2.0, 0.5, 0.1, 0.965
# The scaled misfit that rows are weighed by, at first and at least, and by how much it falls in a step.
FIRST, LEAST, FALL = 5.0, 1e-7, 0.7
DAMPING, EASIEST, EASIER, HARDER = 1.0, 1e-9, 0.2, 2.0
N_TRIALS = 10
# Steps of a constant beyond which a step is shortened, and part of a step at which its bend is measured.
MOST_STEP, PART = 3.0, 0.1
# A step bends too much where its correction is this part of it (Transtrum and Sethna 2012, arXiv:1201.5885).
BENT = 0.75
# A fit ends after so many steps in a row that gain less than this in the logarithm of the probability.
LITTLE, N_LITTLE = 0.1, 3


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
    noise: float = FIRST


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
    form = network.form
    features = form.features(u, network.unit)
    target = (y - network.level) * network.unit
    root = np.sqrt(share)[:, None]
    n_counted = float(share.sum()) * y[0].size
    n_elements, (n_blocks, n_features) = form.n_elements, network.weights.shape
    free = np.flatnonzero(form.is_free.reshape(-1))
    by_unit = np.outer(form.by_unit, form.by_unit) / UNITS**2
    squares = (features[:, :, None] * features[:, None, :]).reshape(len(u), -1)
    precision = form.precision.copy()
    damping, harder, n_little = DAMPING, HARDER, 0

    def off(weights: FloatArray) -> FloatArray:
        sums: FloatArray = weights[:n_elements] @ form.by_unit - form.powers * form.by_unit.any()
        return sums / UNITS

    def cost(weights: FloatArray, misfit: FloatArray) -> float:
        known = float((precision * (weights - form.mean) ** 2).sum() + np.square(off(weights)).sum())
        return 0.5 * (float(np.square(misfit).sum()) / (N_ALIKE * noise**2) + known)

    def misfit_of(weights: FloatArray) -> FloatArray:
        solved, _ = replace(network, weights=weights).solved(features, with_slopes=False)
        return np.asarray(root * (solved - target).reshape(len(u), -1))

    solved, slopes = network.solved(features, with_slopes=True)
    misfit, slopes = root * (solved - target).reshape(len(u), -1), root[:, :, None] * slopes
    for _ in range(n_steps):
        weights = network.weights
        width = max(width * NARROWER, NARROW)
        noise = max(float(np.sqrt(np.square(misfit).sum() / n_counted)), FALL * noise, LEAST)
        weight = 1.0 / (N_ALIKE * noise**2)
        precision[:n_elements, 1:] = 2.0 * COST / (width**2 + weights[:n_elements, 1:] ** 2)
        gradient = weight * np.einsum("rte,rt->re", slopes, misfit).T @ features
        gradient += precision * (weights - form.mean)
        gradient[:n_elements] += np.outer(off(weights), form.by_unit) / UNITS
        products = np.matmul(slopes.transpose(0, 2, 1), slopes).reshape(len(u), -1)
        hessian = weight * (products.T @ squares).reshape(n_blocks, n_blocks, n_features, n_features)
        for element in range(n_elements):
            hessian[element, element] += by_unit
        hessian = hessian.transpose(0, 2, 1, 3).reshape(n_blocks * n_features, -1)[np.ix_(free, free)]
        places = np.arange(free.size)
        hessian[places, places] += precision.reshape(-1)[free]
        slope, before = gradient.reshape(-1)[free], cost(weights, misfit)

        def whole(step: FloatArray) -> FloatArray:
            full = np.zeros(n_blocks * n_features)
            full[free] = step
            return full.reshape(n_blocks, n_features)

        found = None
        for _ in range(N_TRIALS):
            damped = hessian.copy()
            damped[places, places] += damping * form.precision.reshape(-1)[free]
            factor = cho_factor(damped, overwrite_a=True, check_finite=False)
            straight = whole(-cho_solve(factor, slope, check_finite=False))
            # The bend of the path, from the second derivative along the step.
            along = np.einsum("rte,re->rt", slopes, features @ straight.T)
            bend = 2.0 / PART * ((misfit_of(weights + PART * straight) - misfit) / PART - along)
            pull = weight * np.einsum("rte,rt->re", slopes, bend).T @ features
            turn = whole(-cho_solve(factor, pull.reshape(-1)[free], check_finite=False))
            size = np.sqrt((form.precision * straight**2).sum())
            if np.sqrt((form.precision * turn**2).sum()) <= BENT * size:
                step = straight + 0.5 * turn
                step *= min(1.0, MOST_STEP / float(np.abs(step[:n_elements, 0]).max()))
                there = misfit_of(weights + step)
                after = cost(weights + step, there)
                if after < before:
                    expected = -float(slope @ straight.reshape(-1)[free]) * 0.5
                    found = (weights + step, before - after, (before - after) / expected)
                    break
            damping *= harder
            harder *= 1.5
        if found is None:
            break
        # Nielsen's rule (1999): damping follows from how much of the expected gain was found.
        damping = max(damping * max(EASIER, 1.0 - (2.0 * min(found[2], 1.0) - 1.0) ** 3), EASIEST)
        harder = HARDER
        network = replace(network, weights=found[0])
        solved, slopes = network.solved(features, with_slopes=True)
        misfit, slopes = root * (solved - target).reshape(len(u), -1), root[:, :, None] * slopes
        n_little = n_little + 1 if found[1] < LITTLE else 0
        if n_little == N_LITTLE:
            break
    return Fit(network, float(np.sqrt(np.square(misfit).sum() / n_counted)), width, noise)
