"""Markov chains of a density that costs little: an ensemble whose walkers step along their differences.

emcee is used instead of a sampler of our own: differential evolution and snooker moves take the density's
scales and correlations from the ensemble itself, so curved and narrow valleys need no tuning, whole halves of
the ensemble are asked at once, and the estimate of the autocorrelation time comes with it. It is pure Python
and needs NumPy alone.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import emcee
import numpy as np
from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray

N_KEPT = 4000
"""Points that are kept of a chain."""


@dataclass(frozen=True, eq=False)
class Chain:
    """What a chain came to.

    Attributes:
        u: Points, thinned, in the order of time. Shape (n, p). [1]
        log_density: Their density's logarithm. Shape (n,). [1]
        ensemble: The walkers' last places. Shape (w, p). [1]
        n_effective: Independent points that the whole chain is worth, by its slowest coordinate.
        acceptance: Share of steps that were taken. [1]
    """

    u: FloatArray
    log_density: FloatArray
    ensemble: FloatArray
    n_effective: float
    acceptance: float


def run_chain(
    log_density: Callable[[FloatArray], FloatArray], ensemble: FloatArray, *, seed: int, n_steps: int
) -> Chain:
    """Sample a density.

    Args:
        log_density: Logarithm of the density of points, shape (n, p); minus infinity outside its support.
        ensemble: First places of the walkers, all inside. Shape (w, p). [1]
        seed: Seed of all draws.
        n_steps: Steps of every walker; the first third is left out.

    Returns:
        The chain.
    """
    n_walkers, p = ensemble.shape
    moves = [
        (emcee.moves.DEMove(), 0.7),
        (emcee.moves.DESnookerMove(), 0.1),
        (emcee.moves.StretchMove(), 0.2),
    ]
    sampler = emcee.EnsembleSampler(n_walkers, p, log_density, moves=moves, vectorize=True)
    start = emcee.State(ensemble, random_state=np.random.RandomState(seed).get_state())
    with threadpool_limits(limits=1, user_api="blas"):
        last = sampler.run_mcmc(start, n_steps, skip_initial_state_check=True)
    n_burnt = n_steps // 3
    steps = np.asarray(sampler.get_chain(discard=n_burnt), dtype=np.float64)
    # A short chain is told by its effective size, not by a warning.
    logging.getLogger("emcee.autocorr").setLevel(logging.ERROR)
    times = np.asarray(emcee.autocorr.integrated_time(steps, quiet=True), dtype=np.float64)
    thin = max(1, len(steps) * n_walkers // N_KEPT)
    return Chain(
        u=steps[::thin].reshape(-1, p),
        log_density=np.asarray(sampler.get_log_prob(discard=n_burnt)[::thin], dtype=np.float64).reshape(-1),
        ensemble=np.asarray(last.coords, dtype=np.float64),
        n_effective=len(steps) * n_walkers / max(float(np.nanmax(times, initial=1.0)), 1.0),
        acceptance=float(np.mean(sampler.acceptance_fraction)),
    )
