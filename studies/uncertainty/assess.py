"""How sure a calibration is: differences at its point, then a posterior sample around it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from simulation.trajectories import Trajectories
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.recorder import Recorder
from studies.uncertainty.density import Posterior
from studies.uncertainty.emulator import sample_with
from studies.uncertainty.findings import ENDS
from studies.uncertainty.identifiability import Identifiability, difference_rows, judged
from studies.uncertainty.noise import Noise
from studies.uncertainty.rows import joined
from studies.uncertainty.sample import PosteriorSample, PosteriorSampler, Sampling

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
            f"--max-calls {max_calls} does not hold {n_differences} differences ({n_parameters} parameters) "
            f"and a sample of {least}; give {n_differences + least} or more"
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
    on_phase: OnPhase | None = None,
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
    report = on_phase or (lambda what, done, total: None)
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
        on_progress=lambda now: report(now.phase, now.n_done, sampling.max_calls),
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
            on_share=lambda share: report("sampling by state equations", round(100 * share), 100),
        )
        if sample is not None:
            return Assessment(noise, around.take(0), local, sample, 0, by_equations=True)
        # Rows that disproved the equations still teach the surrogate, and count as calls.
        stored_rows = [*stored_rows, asked]
    # Of disproved equations the slopes are not used either: the model is asked for them.
    report("differences", 0, 2 * p)
    around, local = differences(problem)
    report("differences", 2 * p, 2 * p)
    known = joined([*stored_rows, around])
    sample = PosteriorSampler(recorder, posterior, sampling, known, seed=seed).sample()
    return Assessment(noise, around.take(0), local, sample, 2 * p, by_equations=False)
