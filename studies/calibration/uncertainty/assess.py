"""How sure a calibration is: differences at its point, then a posterior sample around it.

Where state equations are known, the sample is one of them: their density itself is sampled, so that a narrow
bent valley is followed to its ends. The real model simulates the members, and each counts as much as the real
density exceeds theirs. Where the two are not the same density, there is no such sample.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from simulation.trajectories import Trajectories
from studies.calibration.descent import descend_together, jacobians
from studies.calibration.differences import difference_rows
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import Recorder
from studies.calibration.uncertainty.annealing import Density, OnShare, Reference, sample_density
from studies.calibration.uncertainty.density import Posterior, roots_of
from studies.calibration.uncertainty.findings import ENDS
from studies.calibration.uncertainty.identifiability import Identifiability, judged
from studies.calibration.uncertainty.noise import Noise
from studies.calibration.uncertainty.rows import joined
from studies.calibration.uncertainty.sample import (
    DECIMALS,
    NEAR_BEST,
    WIDER,
    PosteriorSample,
    PosteriorSampler,
    Sampling,
    agrees,
    decimals_for,
    most_probable,
    simulated,
)

STEP = 0.01
"""Step of the differences, as a share of the range: so wide that the surrogate learns from them, too."""

Z = 1.6448536269514722
"""Quantile of the normal distribution at the upper end of an interval, `ENDS`."""

OnPhase = Callable[[str, int, int], None]
"""Called with the name of a phase, the rows asked in it and the most that it may ask."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """How sure a calibration is.

    Attributes:
        noise: What the residuals are taken for.
        point: The calibrated point as the model answered. One row.
        local: What the residuals around it determine.
        sample: Equally good parameter sets.
        n_differences: Rows asked for the differences; the point itself was known.
        by_equations: Whether state equations gave all but the sample.
    """

    noise: Noise
    point: Evaluation
    local: Identifiability
    sample: PosteriorSample
    n_differences: int
    by_equations: bool

    @property
    def n_calls(self) -> int:
        """Rows asked of the model."""
        return self.n_differences + self.sample.n_calls

    @property
    def linear(self) -> FloatArray:
        """Ends of the linearised intervals; beyond 0 and 1 the box cuts them. Shape (2, p). [1]."""
        half = Z * self.local.spread
        ends = np.stack([self.point.u[0] - half, self.point.u[0] + half])
        return np.asarray(np.clip(ends, 0.0, 1.0), dtype=np.float64)

    @property
    def interval(self) -> FloatArray:
        """Ends and median of the posterior's intervals: low, median, high. Shape (3, p). [1]."""
        # Of particles, not of the simulated members: of 48, two or three lie beyond an end of the interval.
        shares = ENDS[0], 0.5, ENDS[1]
        return np.quantile(self.sample.particles, shares, axis=0)


def sampling_within(max_calls: int, n_parameters: int) -> Sampling:
    """Return how a posterior is sampled with the calls that the differences leave.

    Args:
        max_calls: Most rows that may be asked of the model.
        n_parameters: Number of parameters.

    Raises:
        InputError: They leave too few.
    """
    n_differences, least = 2 * n_parameters, 2 * Sampling.n_batch
    if max_calls < n_differences + least:
        raise InputError(
            f"--max-calls {max_calls} must be at least {n_differences + least}: {n_differences} simulations "
            f"for the slopes of {n_parameters} parameters, and a sample of {least}"
        )
    return Sampling(max_calls=max_calls - n_differences)


def assess(
    problem: CalibrationProblem,
    theta: FloatArray,
    y: FloatArray,
    *,
    noise: Noise,
    known: Evaluation | None,
    sampling: Sampling,
    seed: int,
    emulator: ForwardModel | None = None,
    on_phase: OnPhase = lambda what, done, total: None,
) -> Assessment:
    """Say how sure a calibration is.

    Args:
        problem: The problem, posed to the physical model.
        theta: The calibrated point. Shape (p,). [per parameter]
        y: What the model answered there. Shape (t, k). [per output]
        noise: What the residuals are taken for.
        known: Rows that are known already, or None.
        sampling: How the posterior is sampled.
        seed: Seed of all draws.
        emulator: The model's state equations, where they are known exactly: then the model simulates the
            sample alone, as long as it agrees.
        on_phase: Called with how far it is.
    """
    space, model = problem.space, problem.model
    p = space.n_parameters
    # Rounding may put a parameter at its bound just outside the cube.
    rows = difference_rows(np.clip(space.to_unit(theta), 0.0, 1.0), STEP)
    answered = Trajectories(theta[None], y[None], model.time, space.names, model.output_names, ("",))
    posterior, stored_rows = Posterior(noise, problem.prior), [] if known is None or not known.n else [known]

    def differences(asked: CalibrationProblem) -> tuple[Evaluation, Identifiability]:
        # The point itself was simulated by the calibration and costs no call.
        around = joined([problem.judge(rows[:1], answered), asked.evaluate(rows[1:])])
        found = judged(space.names, around, noise.raised, STEP, prior=problem.prior)
        return around, found

    recorder = Recorder(
        problem,
        phase="posterior sample",
        on_progress=lambda now: on_phase(now.phase, now.n_done, sampling.max_calls),
    )
    # With equations 48 calls, without them 70 and 168, at about equal coverage (docs/notes/uncertainty.md).
    if emulator is not None:
        solved = problem.on(emulator)
        around, local = differences(solved)
        sample, asked = sample_with(
            solved,
            recorder,
            posterior,
            sampling,
            # What was simulated, not solved.
            joined([*stored_rows, around.take(0)]),
            seed=seed,
            on_share=lambda share: on_phase("sampling by state equations", round(100 * share), 100),
        )
        if sample is not None:
            return Assessment(noise, around.take(0), local, sample, 0, by_equations=True)
        # Rows that disproved the equations still teach the surrogate, and count as calls.
        stored_rows = [*stored_rows, asked]
    # Of disproved equations the slopes are not used either: the model is asked for them.
    on_phase("differences", 0, 2 * p)
    around, local = differences(problem)
    on_phase("differences", 2 * p, 2 * p)
    known = joined([*stored_rows, around])
    sample = PosteriorSampler(recorder, posterior, sampling, known, seed=seed).sample()
    return Assessment(noise, around.take(0), local, sample, 2 * p, by_equations=False)


# Intervals are of particles, which the FMU does not weigh: so the two densities themselves must agree.
SAME_DENSITY = 0.25
"""Mean difference of the two logarithmic densities, but for a constant, up to which they are the same."""

# 600 particles take 60,000 to 100,000 solutions: with 64 states, 9 ms each, that is 9 to 15 minutes.
LEAST_PARTICLES, CHEAP = 150, 4e5
"""Points that stand for the density at least, where an answer takes more operations than the second."""

# Ends of 25 descents; a narrow valley that even particles would miss is then known from the start.
N_TRIED, N_FROM_TRIED, N_FROM_STORED = 400, 20, 5
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
    on_share: OnShare,
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
    best = most_probable(posterior, joined([known, drawn]))
    return PosteriorSample(drawn, ratios, particles, recorder.n_calls, best), drawn


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
    looks = rng.random((N_TRIED, p))
    best = np.argsort(-density(looks), kind="stable")[:N_FROM_TRIED]
    rows = np.argsort(-posterior.at(known.u, known.mse), kind="stable")[:N_FROM_STORED]
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
