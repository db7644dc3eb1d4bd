"""Markov chains of a density that costs little: an ensemble whose walkers step along their differences.

emcee is used instead of a sampler of our own: differential evolution and snooker moves take the density's
scales and correlations from the ensemble itself, whole halves of the ensemble are asked at once, and the
estimate of the autocorrelation time comes with it. It is pure Python and needs NumPy alone.

An ensemble of one shape does not follow a narrow valley round a bend. So a chain begins hot, where valleys
are wide and walkers spread along them, and cools down before it counts; a quarter of the steps are drawn from
a normal density that suits the place where they begin (a metric, as in Girolami and Calderhead,
doi:10.1111/j.1467-9868.2010.00765.x, without its drift), the way back weighed against the way there.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import emcee
import numpy as np
from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray

USUAL_STEP, SHORTEST = 2.38, 0.2
"""Steps of a random walk in p dimensions: the first over the root of p, and down to the second of that."""

TEMPERATURES = (8.0, 5.6, 4.0, 2.8, 2.0, 1.4)
"""A chain cools down along these before it counts: where a valley is wide, its bends are no obstacle."""

TWINS_APART = 1e-6
"""So far walkers that come of one are put from each other. [1]"""

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


Density = Callable[[FloatArray], FloatArray]
"""Logarithm of a density at points, shape (n, p); minus infinity outside its support."""

Metric = Callable[[FloatArray], FloatArray]
"""Precision of steps that suit points, shape (n, p, p)."""


def run_chain(
    log_density: Density, ensemble: FloatArray, *, seed: int, n_steps: int, metric: Metric | None = None
) -> Chain:
    """Sample a density.

    Args:
        log_density: The density.
        ensemble: First places of the walkers, all inside. Shape (w, p). [1]
        seed: Seed of all draws.
        n_steps: Steps of every walker; the first third cools down and is left out.
        metric: What steps suit a place; without it all follow the ensemble.

    Returns:
        The chain.
    """
    n_walkers, rng = len(ensemble), np.random.default_rng(seed)
    n_cooling = n_steps // 3 // len(TEMPERATURES)
    state = emcee.State(ensemble, random_state=np.random.RandomState(seed).get_state())
    with threadpool_limits(limits=1, user_api="blas"):
        for temperature in TEMPERATURES:
            state = _sampler(log_density, ensemble.shape, metric, temperature).run_mcmc(
                emcee.State(state.coords, random_state=state.random_state),
                n_cooling,
                skip_initial_state_check=True,
            )
            state = emcee.State(
                _survivors(log_density, state.coords, temperature, rng), random_state=state.random_state
            )
        sampler = _sampler(log_density, ensemble.shape, metric, 1.0)
        last = sampler.run_mcmc(
            emcee.State(state.coords, random_state=state.random_state),
            n_steps - n_cooling * len(TEMPERATURES),
            skip_initial_state_check=True,
        )
    steps = np.asarray(sampler.get_chain(), dtype=np.float64)
    # A short chain is told by its effective size, not by a warning.
    logging.getLogger("emcee.autocorr").setLevel(logging.ERROR)
    times = np.asarray(emcee.autocorr.integrated_time(steps, quiet=True), dtype=np.float64)
    thin = max(1, len(steps) * n_walkers // N_KEPT)
    return Chain(
        u=steps[::thin].reshape(-1, ensemble.shape[1]),
        log_density=np.asarray(sampler.get_log_prob()[::thin], dtype=np.float64).reshape(-1),
        ensemble=np.asarray(last.coords, dtype=np.float64),
        n_effective=len(steps) * n_walkers / max(float(np.nanmax(times, initial=1.0)), 1.0),
        acceptance=float(np.mean(sampler.acceptance_fraction)),
    )


def _survivors(
    log_density: Density, u: FloatArray, temperature: float, rng: np.random.Generator
) -> FloatArray:
    """Draw walkers by what they are worth one stage colder: those in a hollow of little mass die out."""
    colder = next((t for t in TEMPERATURES if t < temperature), 1.0)
    log_weights = log_density(u) * (1.0 / colder - 1.0 / temperature)
    weights = np.exp(log_weights - log_weights.max())
    ends = np.cumsum(weights / weights.sum())
    drawn = np.searchsorted(ends, (np.arange(len(u)) + rng.random()) / len(u))
    chosen = u[np.minimum(drawn, len(u) - 1)]
    # Twins would step along differences of nothing.
    survivors: FloatArray = np.clip(chosen + TWINS_APART * rng.standard_normal(u.shape), 0.0, 1.0)
    return survivors


def _sampler(
    log_density: Density, shape: tuple[int, ...], metric: Metric | None, temperature: float
) -> emcee.EnsembleSampler:
    """Return a sampler of a density to the power of 1 / temperature."""
    moves = [
        (emcee.moves.DEMove(), 0.7),
        (emcee.moves.DESnookerMove(), 0.1),
        (emcee.moves.StretchMove(), 0.2),
    ]
    if metric is not None:
        moves.append((emcee.moves.MHMove(_LocalSteps(lambda u: metric(u) / temperature)), 0.3))
    return emcee.EnsembleSampler(*shape, lambda u: log_density(u) / temperature, moves=moves, vectorize=True)


class _LocalSteps:
    """Steps of a random walk whose covariance suits the place where they begin."""

    def __init__(self, metric: Metric) -> None:
        self._metric = metric

    def __call__(self, u: FloatArray, random: np.random.RandomState) -> tuple[FloatArray, FloatArray]:
        """Propose a step of every walker.

        Args:
            u: Their places. Shape (w, p). [1]
            random: Source of the draws.

        Returns:
            The new places, and the logarithm of the way back's density over that of the way there.
        """
        n, p = u.shape
        scale = USUAL_STEP / np.sqrt(p) * np.exp(random.uniform(np.log(SHORTEST), 0.0, size=n))
        here = self._metric(u)
        drawn = random.standard_normal((n, p, 1))
        roots = np.linalg.cholesky(here)
        step = scale[:, None] * np.linalg.solve(np.swapaxes(roots, 1, 2), drawn)[:, :, 0]
        there = self._metric(u + step)
        return u + step, _log_density(step, there, scale) - _log_density(step, here, scale)


def _log_density(step: FloatArray, precision: FloatArray, scale: FloatArray) -> FloatArray:
    """Return the logarithm of normal densities of steps, but for a constant. Shape (w,)."""
    lengths = np.einsum("wi,wij,wj->w", step, precision, step) / scale**2
    found: FloatArray = 0.5 * (np.linalg.slogdet(precision).logabsdet - lengths)
    return found
