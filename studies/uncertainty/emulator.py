"""A posterior sample of a model that costs next to nothing and is as good as the real one.

The emulator's density itself is sampled: nothing of it is learnt, so a narrow bent valley is followed to its
ends. The real model simulates the members of the sample, and each counts as much as the real density exceeds
the emulator's. Where the two are not the same density, there is no such sample.
"""

import numpy as np
from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray
from studies.calibration.descent import descend_together, jacobians
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import Recorder
from studies.uncertainty.annealing import Density, OnShare, Reference, sample_density
from studies.uncertainty.density import Posterior, roots_of
from studies.uncertainty.rows import joined
from studies.uncertainty.sample import (
    DECIMALS,
    NEAR_BEST,
    WIDER,
    PosteriorSample,
    Sampling,
    agrees,
    decimals_for,
    simulated,
)

# Intervals are of particles, which the FMU does not weigh: so the two densities themselves must agree.
SAME_DENSITY = 0.25
"""Mean difference of the two logarithmic densities, but for a constant, up to which they are the same."""

# 600 particles take 60,000 to 100,000 solutions: with 64 states, 9 ms each, that is 9 to 15 minutes.
LEAST_PARTICLES, CHEAP = 150, 4e5
"""Points that stand for the density at least, where an answer takes more operations than the second."""

# Ends of 25 descents; a narrow valley that even particles would miss is then known from the start.
N_LOOKS, N_RANDOM, N_ROWS = 400, 20, 5
"""Random points, and how many of them and of the stored rows, the best ones, are walked downhill."""


def particles_for(n_operations: float) -> int:
    """Return how many particles an emulator's density is sampled with.

    Args:
        n_operations: What one of its answers takes.
    """
    n = Sampling.n_of_emulator
    return int(np.clip(n * CHEAP / max(n_operations, 1.0), LEAST_PARTICLES, n))


def sample_with(
    emulator: CalibrationProblem,
    recorder: Recorder,
    posterior: Posterior,
    settings: Sampling,
    known: Evaluation,
    *,
    seed: int,
    on_share: OnShare | None = None,
) -> tuple[PosteriorSample | None, Evaluation]:
    """Sample a posterior by an emulator, and have the model simulate the sample.

    Args:
        emulator: The problem, posed to the emulator.
        recorder: Asks the physical model and counts.
        posterior: The density.
        settings: How to sample; the budget is of the physical model.
        known: Rows that are known already.
        seed: Seed of all draws.
        on_share: Called with how far the emulator's density is sampled.

    Returns:
        The sample, None where the real model disagrees, and the rows that it was asked.
    """
    rng = np.random.default_rng(seed)

    def density(u: FloatArray) -> FloatArray:
        return posterior.at(u, emulator.mse(u))

    with threadpool_limits(limits=1, user_api="blas"):
        # The density itself: particles of a process taught by equations were worth 24 to 53 %.
        around, decimals = _valleys(emulator, posterior, density, known, rng)
        particles = sample_density(
            density,
            around,
            seed=int(rng.integers(2**31)),
            n_particles=settings.n_of_emulator,
            on_share=on_share,
        )
    # Particles come in no order, so the first ones are a sample like all.
    u = np.round(particles[: min(settings.n_sample, settings.max_calls)], decimals)

    def differs(ratios: FloatArray) -> bool:
        # With less than a batch left no other way could begin, so a poor sample is better than none.
        is_left = settings.max_calls - recorder.n_calls >= settings.n_batch
        return is_left and not (_differ(ratios) <= SAME_DENSITY and agrees(ratios, settings.n_batch))

    drawn, ratios = simulated(recorder.evaluate, posterior, density, u, settings.n_batch, differs)
    if differs(ratios):
        return None, drawn
    every = joined([known, drawn])
    best = int(np.argmax(posterior.at(every.u, every.mse)))
    mse = float(every.mse[best])
    return PosteriorSample(drawn, ratios, particles, recorder.n_calls, every.u[best], mse), drawn


def _valleys(
    emulator: CalibrationProblem,
    posterior: Posterior,
    density: Density,
    known: Evaluation,
    rng: np.random.Generator,
) -> tuple[Reference, int]:
    """Walk downhill from all over the cube, and from what is known.

    Returns:
        Where particles begin, and to how many decimals points are rounded.
    """
    p, residuals = emulator.space.n_parameters, emulator.residuals
    looks = rng.random((N_LOOKS, p))
    best = np.argsort(-density(looks), kind="stable")[:N_RANDOM]
    rows = np.argsort(-posterior.at(known.u, known.mse), kind="stable")[:N_ROWS]
    ends, _ = descend_together(residuals, emulator.prior, np.concatenate([known.u[rows], looks[best]]))
    value = density(ends)
    # Descents also end in local minima, which hold no share of the density worth a particle.
    ends = ends[value >= value.max() - NEAR_BEST]
    slopes = jacobians(residuals, ends, residuals(ends))
    is_finite = np.isfinite(slopes).all(axis=(1, 2))
    # Without slopes no widths are known, so all particles begin anywhere.
    if not is_finite.any():
        return Reference.even(p), DECIMALS
    scaled = slopes[is_finite] / posterior.noise.raised
    metric = scaled.transpose(0, 2, 1) @ scaled
    # Not widened as the start is: rounding has to resolve the density itself.
    steepness = float(np.sqrt(np.diagonal(posterior.precision(metric, wider=1.0), axis1=1, axis2=2).max()))
    around = Reference(ends[is_finite], roots_of(posterior.precision(metric, wider=WIDER)))
    return around, decimals_for(steepness)


def _differ(differences: FloatArray) -> float:
    """Return the mean difference of logarithms (n,) from their middle; of failed rows none is known."""
    # The densities are known but for a constant; a median is no mean that one bad member shifts.
    known = differences[np.isfinite(differences)]
    return float(np.mean(np.abs(known - np.median(known)))) if known.size else np.inf
