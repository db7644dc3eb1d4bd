"""What speaks for a model structure: evidence, information criteria, left-out blocks, white residuals.

All structures are judged with one noise model, so that their likelihoods have the same constant. Evidence is
the likelihood's mean over what was thought possible before: the bounds, evenly in the case's scales, and the
priors. It is made from particles by bridge sampling (Meng and Wong 1996, Statistica Sinica 6, 831), with a
normal distribution in normal scores as the other density.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from scipy.special import gammaincc, logsumexp, ndtr, ndtri
from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray, IntArray
from simulation.layout import MARK
from simulation.measurement import Measurement
from studies.calibration.descent import Residuals, descend_together, jacobians
from studies.calibration.prior import Prior
from studies.calibration.uncertainty.annealing import EDGE, Density, Reference, sample_density
from studies.calibration.uncertainty.density import Posterior, roots_of
from studies.calibration.uncertainty.emulated import weighed
from studies.calibration.uncertainty.sample import WIDER

N_BLOCKS = 5
"""Parts of the time that are left out in turn where there are not as many experiments."""

N_PARTICLES, N_BRIDGED = 300, 20
"""Particles of an evidence (600 spread by as much, 0.3 to 0.5 from seed to seed), and iterations."""

MOST_LAGS = 10
"""Lags of the test of white residuals, at most a fifth of the samples (Ljung and Box 1978)."""


@dataclass(frozen=True)
class Evidence:
    """How probable the data are by a structure.

    Attributes:
        log: Its natural logarithm, but for a constant that all structures have. [1]
        error: Difference of two estimates, of either half of the particles. [1]
    """

    log: float
    error: float


def evidence(residuals: Residuals, posterior: Posterior, best: FloatArray, *, seed: int) -> Evidence:
    """Return the evidence of a structure whose residuals cost nothing.

    Args:
        residuals: Points (n, p) to residuals (n, m).
        posterior: The density.
        best: The calibrated point. Shape (p,). [1]
        seed: Seed of all draws.
    """
    slopes = jacobians(residuals, best[None], residuals(best[None])) / posterior.noise.raised
    around = Reference.even(best.size)
    if np.isfinite(slopes).all():
        metric = slopes.transpose(0, 2, 1) @ slopes
        around = Reference(best[None], roots_of(posterior.precision(metric, wider=WIDER)))

    def density(u: FloatArray) -> FloatArray:
        with np.errstate(all="ignore"):
            mse = np.mean(residuals(u) ** 2, axis=1)
        return posterior.at(u, np.where(np.isfinite(mse), mse, np.inf))

    with threadpool_limits(limits=1, user_api="blas"):
        particles = sample_density(density, around, seed=seed, n_particles=N_PARTICLES)
        z = ndtri(np.clip(particles, EDGE, 1.0 - EDGE))
        rng, halves = np.random.default_rng(seed), (z[::2], z[1::2])
        either = [_bridged(density, halves[one], halves[1 - one], rng) for one in (0, 1)]
    log = float(np.mean(either)) + _log_prior_scale(posterior.prior)
    return Evidence(log, abs(either[0] - either[1]))


def _bridged(density: Density, fitted: FloatArray, others: FloatArray, rng: np.random.Generator) -> float:
    """Return the logarithm of a density's integral, by particles (n, p) in normal scores."""
    p = fitted.shape[1]
    root = np.linalg.cholesky(np.cov(fitted.T).reshape(p, p) + 1e-9 * np.eye(p))
    centre = fitted.mean(axis=0)
    drawn = centre + rng.standard_normal(others.shape) @ root.T

    def log_ratio(z: FloatArray) -> FloatArray:
        # The density in normal scores over the fitted one; of both the factor 2 pi cancels.
        away = np.linalg.solve(root, (z - centre).T)
        normal = -0.5 * np.sum(away**2, axis=0) - np.log(np.diag(root)).sum()
        return np.asarray(density(ndtr(z)) - 0.5 * np.sum(z**2, axis=1) - normal)

    of_others, of_drawn, log = log_ratio(others), log_ratio(drawn), 0.0
    log = float(np.median(of_others))
    for _ in range(N_BRIDGED):
        top = logsumexp(of_drawn - np.logaddexp(of_drawn, log))
        log = float(top - logsumexp(-np.logaddexp(of_others, log)))
    return log


def _log_prior_scale(prior: Prior | None) -> float:
    """Return what makes priors within the bounds integrate to 1. [1]."""
    if prior is None:
        return 0.0
    total = 0.0
    for centre, width in zip(prior.centre[prior.is_held], prior.width[prior.is_held], strict=True):
        normal = NormalDist(float(centre), float(width))
        total -= float(np.log(width * np.sqrt(2.0 * np.pi) * (normal.cdf(1.0) - normal.cdf(0.0))))
    return total


def blocks_of(measurement: Measurement) -> list[IntArray]:
    """Return the residuals that are left out together: of an experiment each, else of parts of the time."""
    experiments = [name.partition(MARK)[2] for name in measurement.output_names]
    if len(set(experiments)) > 1:
        of = np.array(experiments)[measurement.output_of]
        return [np.flatnonzero(of == one) for one in dict.fromkeys(experiments)]
    return np.array_split(np.arange(measurement.n_samples), min(N_BLOCKS, measurement.n_samples))


def left_out_losses(
    residuals: Residuals, posterior: Posterior, starts: FloatArray, blocks: Sequence[IntArray]
) -> FloatArray:
    """Return the mean squared residual of each block, calibrated without it. Shape (b,). [unit squared].

    Args:
        residuals: Points (n, p) to residuals (n, m).
        posterior: The density, for its prior.
        starts: Where calibrations begin. Shape (n, p). [1]
        blocks: Positions of the residuals that are left out together.
    """
    losses = []
    for block in blocks:
        kept = np.setdiff1d(np.concatenate(blocks), block)

        def of_kept(u: FloatArray, kept: IntArray = kept) -> FloatArray:
            return residuals(u)[:, kept]

        ends, values = descend_together(of_kept, weighed(posterior.prior, posterior.noise), starts)
        losses.append(float(np.mean(residuals(ends[[int(np.argmin(values))]])[0, block] ** 2)))
    return np.array(losses)


def whiteness(measurement: Measurement, y: FloatArray) -> float:
    """Return how probable residuals as correlated as these are if they were white (Ljung and Box).

    Of several outputs the least, times their number (Bonferroni). Declared correlation is taken off before.

    Args:
        measurement: What was measured.
        y: The best simulation. Shape (t, k). [per output]
    """
    found = []
    for k in measurement.measured:
        e = measurement.scatter(y, k)
        e, m = e - e.mean(), len(e)
        lags = np.arange(1, min(MOST_LAGS, m // 5) + 1)
        if lags.size and (power := float(e @ e)) > 0.0:
            rho = np.array([float(e[lag:] @ e[:-lag]) / power for lag in lags])
            q = m * (m + 2.0) * float(np.sum(rho**2 / (m - lags)))
            found.append(exceeded(q, len(lags)))
    return min(1.0, len(found) * min(found, default=1.0)) if found else 1.0


def exceeded(value: float, n: int) -> float:
    """Return the probability that chi squared of n degrees of freedom exceeds a value. [1]."""
    return float(gammaincc(0.5 * n, 0.5 * max(value, 0.0)))
