"""A sample of equally good parameter sets: drawn on a surrogate, simulated by the model, reweighted by it.

Rounds: a Gaussian process of the residuals is fitted to all rows known near the optimum, particles sample the
density that it predicts, less where simulations failed, and a batch of them is simulated. Where the model
disagrees with the prediction by too much, the batch teaches the process and the next round begins; where it
agrees, more of the same particles are simulated until the sample is large enough. Each of its members then
weighs as much as the model's density exceeds the predicted one (importance sampling): so the sample is the
model's. Before, batches are asked farther than the density is expected, as long as that finds more of it:
what no member is near to no weight can show.

Rows follow from problem, stored rows, settings and seed alone: repeated over stored simulations, a sampling
goes on where it stopped.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Protocol

import numpy as np
from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray
from studies.calibration.problem import Evaluation
from studies.calibration.processes.process import Features, ResidualProcess
from studies.calibration.recorder import Recorder
from studies.calibration.uncertainty.annealing import Density, Reference, sample_density
from studies.calibration.uncertainty.density import Posterior, Predicted
from studies.calibration.uncertainty.rows import informative_rows, joined, log_success
from studies.calibration.uncertainty.weights import effective_size, normalized

# A store finds a row by the exact bytes of its parameters.
DECIMALS, STEPS_PER_DEVIATION = 5, 5.0
"""Points are rounded to this many decimals of the unit cube, so that a store finds them again, or to so many
that a parameter's deviation, the others held, has these steps."""

AGREEMENT = 0.5, 0.4
"""A batch that is worth the first share of its size by its weights agrees with the surrogate; a sample whose
worth falls below the second share of its size is given up while calls are left."""

# exp(-10) of the best density: a valley so improbable holds next to no member of a sample.
NEAR_BEST, MOST_CENTRES = 10.0, 50
"""Particles also begin around stored rows whose logarithmic density lacks no more than the first to the best
one, around so many at most."""

# Half of the logarithm alone covered less of long valleys: 72, 62 and 44 % instead of 84, 76 and 61 %.
FARTHER = 0.25, 0.1
"""Before a sample is drawn, rows are asked where the density would be with these parts of the caution."""

MORE, UNEXPECTED = 5.0, 1.0
"""They find more if one's logarithmic density lacks no more than the first to the best one, and is greater
than expected by the second."""

# A start that is too wide loses particles at the first powers, one that is too narrow misses the edges.
WIDER = 3.0
"""And that much wider than the surrogate expects the density to be there."""


@dataclass(frozen=True)
class Sampling:
    """How a posterior is sampled.

    Attributes:
        max_calls: Most rows that may be asked of the model.
        n_sample: Size of the sample that is simulated.
        n_batch: Rows per round.
        n_particles: Points that stand for the last surrogate's density.
        n_drawn_from: And for an earlier one's, of which no more than the sample is drawn.
        n_of_emulator: And for an emulator's, which is asked at each of them again and again.
    """

    max_calls: int
    n_sample: int = 48
    n_batch: int = 8
    # Rounds that teach need no more than candidates: 400 particles there halve the time of an assessment.
    n_particles: int = 1200
    n_drawn_from: int = 400
    n_of_emulator: int = 600


@dataclass(frozen=True, eq=False)
class PosteriorSample:
    """Equally good parameter sets.

    Attributes:
        drawn: The sample as the model answered. n rows.
        log_ratios: Logarithm of the model's density over the predicted one. Shape (n,). [1]
        particles: Points of equal weight on the last surrogate, which knows every simulated row, or on the
            emulator. Shape (s, p). [1]
        n_calls: Rows asked of the model.
        best: The most probable row of all, asked or known before.
    """

    drawn: Evaluation
    log_ratios: FloatArray
    particles: FloatArray
    n_calls: int
    best: Evaluation

    @cached_property
    def weights(self) -> FloatArray:
        """What each counts; sum 1. Shape (n,). [1]."""
        return normalized(self.log_ratios)

    @property
    def n_taught(self) -> int:
        """Rows asked of the model that are not in the sample: they taught the surrogate."""
        return self.n_calls - self.drawn.n

    @property
    def n_effective(self) -> float:
        """Members of equal weight that the sample is worth, none where no simulation succeeded."""
        return effective_size(self.weights) if np.isfinite(self.log_ratios).any() else 0.0


class Expected(Protocol):
    """Logarithms of the density that is expected of points."""

    def __call__(self, u: FloatArray, caution: float = 1.0) -> FloatArray:
        """Return them at points (n, p), with a part of the caution. Shape (n,)."""


class PosteriorSampler:
    """The rows of one sampling."""

    def __init__(
        self,
        recorder: Recorder,
        posterior: Posterior,
        settings: Sampling,
        known: Evaluation,
        *,
        seed: int,
    ) -> None:
        """Begin with what is known.

        Args:
            recorder: Asks the physical model and counts.
            posterior: The density.
            settings: How to sample.
            known: Rows that are known already.
            seed: Seed of all draws.
        """
        self._recorder, self._posterior, self._settings = recorder, posterior, settings
        self._features = Features.of(recorder.problem.space)
        self._rng = np.random.default_rng(seed)
        self._rows = known
        self._hyper: FloatArray | None = None
        self._decimals = DECIMALS
        self._is_bounded = False
        self._n_known = known.n

    def sample(self) -> PosteriorSample:
        """Sample the posterior."""
        # One BLAS thread is five times faster on matrices of a hundred rows, with equal bits.
        with threadpool_limits(limits=1, user_api="blas"):
            n_teaching = self._settings.n_drawn_from
            while True:
                expected, around = self._learn(n_teaching)
                # What it found is not in the process yet, so a round begins anew before anything is drawn.
                if self._finds_more(expected, around):
                    continue
                particles = self._particles(expected, around, n_teaching)
                drawn, ratios, is_good = self._simulate(expected, particles)
                if is_good or not self._has_another_round:
                    break
            n_last = self._settings.n_particles
            # Intervals are of these: they know the last batch too, and are many enough for the tails.
            last = self._particles(*self._learn(n_last), n_last)
        best = most_probable(self._posterior, self._rows)
        return PosteriorSample(drawn, ratios, last, self._recorder.n_calls, best)

    def _learn(self, n_particles: int) -> tuple[Expected, Reference]:
        """Fit the process to what is known.

        Args:
            n_particles: As many look for regions that are not known yet.

        Returns:
            The density that it expects, and where a sample of it begins.
        """
        known = self._rows
        density = self._posterior.at(known.u, known.mse)
        rows = informative_rows(known.u, density, self._n_known)
        # From the last hyperparameters: few rows are new since, so few iterations are needed.
        process = ResidualProcess.fit(self._features, known.u[rows], known.residuals[rows], self._hyper)
        self._hyper = process.hyper
        predicted = Predicted(process)
        raised = self._posterior.noise.raised
        narrowest = self._posterior.precision(predicted.metric(known.u[rows[:1]], raised), wider=1.0)
        self._decimals = decimals_for(float(np.sqrt(np.diagonal(narrowest[0]).max())))
        # A narrow region that no even start finds is not lost as long as a row lies in it.
        good = known.u[rows[density[rows] >= density[rows[0]] - NEAR_BEST][:MOST_CENTRES]]
        failed = ~np.isfinite(known.mse)

        def expected(u: FloatArray, caution: float = 1.0) -> FloatArray:
            # Failed rows have no residuals to teach the process: 94 to 96 of 96 failed at an edge.
            value: FloatArray = self._posterior.by(predicted, u, caution=caution)
            return value + log_success(u, known.u, failed, narrowest[0])

        # A narrow region that is known would crowd out wider ones, and they it, if either began alone.
        anywhere = self._particles(expected, Reference.even(known.u.shape[1]), n_particles)
        centres = np.concatenate([good, anywhere[:MOST_CENTRES]])
        precision = self._posterior.precision(predicted.metric(centres, raised), wider=WIDER)
        roots = np.asarray(np.linalg.cholesky(np.linalg.inv(precision)), dtype=np.float64)
        return expected, Reference(centres, roots)

    def _particles(self, expected: Density, around: Reference, n_particles: int) -> FloatArray:
        """Sample a density by so many particles, with a seed of their own."""
        seed = int(self._rng.integers(2**31))
        return sample_density(expected, around, seed=seed, n_particles=n_particles)

    def _finds_more(self, expected: Expected, around: Reference) -> bool:
        """Whether rows that are less sure turn out well where it was not expected; once not, never again."""
        # This batch, and two for the sample that follows.
        if self._is_bounded or self._n_left < 3 * self._settings.n_batch:
            return False
        n_each = self._settings.n_batch // len(FARTHER)
        n = self._settings.n_drawn_from
        # No sample is drawn so: unsure places would count as probable (six walls: 86 instead of 95 %).
        wider = [self._particles(partial(expected, caution=caution), around, n) for caution in FARTHER]
        u = np.round(np.concatenate([particles[:n_each] for particles in wider]), self._decimals)
        # Before they are asked, as asking adds them to the rows of which the best is taken.
        before, best = expected(u), float(self._posterior.at(self._rows.u, self._rows.mse).max())
        found = self._posterior.at(u, self._ask(u).mse)
        self._is_bounded = not bool(np.any((found > best - MORE) & (found > before + UNEXPECTED)))
        return not self._is_bounded

    @property
    def _n_left(self) -> int:
        """Rows that may still be asked."""
        return self._settings.max_calls - self._recorder.n_calls

    @property
    def _has_another_round(self) -> bool:
        """Whether the calls that are left allow a sample of two batches."""
        return self._n_left >= 2 * self._settings.n_batch

    def _simulate(self, expected: Density, particles: FloatArray) -> tuple[Evaluation, FloatArray, bool]:
        """Simulate particles as long as the model agrees.

        Args:
            expected: Logarithm of the density that is expected of points.
            particles: A sample of it.

        Returns:
            The members, the logarithms of the model's density over the predicted one, and whether they agree.
        """
        n_batch = self._settings.n_batch
        u = np.round(particles[: min(self._settings.n_sample, self._n_left)], self._decimals)

        def is_poor(ratios: FloatArray) -> bool:
            # With no calls for another round a poor sample is completed: its weights show what it is worth.
            return self._has_another_round and not agrees(ratios, n_batch)

        drawn, ratios = simulated(self._ask, self._posterior, expected, u, n_batch, is_poor)
        return drawn, ratios, agrees(ratios, n_batch)

    def _ask(self, u: FloatArray) -> Evaluation:
        answer = self._recorder.evaluate(u)
        self._rows = joined([self._rows, answer])
        return answer


def simulated(
    ask: Callable[[FloatArray], Evaluation],
    posterior: Posterior,
    expected: Density,
    u: FloatArray,
    n_batch: int,
    is_given_up: Callable[[FloatArray], bool],
) -> tuple[Evaluation, FloatArray]:
    """Simulate the members of a sample, in no order, batch by batch.

    Args:
        ask: Asks the physical model.
        posterior: The density.
        expected: Logarithm of the density that they were drawn from.
        u: The members. Shape (n, p). [1]
        n_batch: Rows of a batch.
        is_given_up: Whether the sample is given up, by the ratios so far.

    Returns:
        The simulated ones, and the logarithms of the model's density over the expected one. [1]
    """
    parts, ratios = list[Evaluation](), np.empty(0)
    while len(ratios) < len(u):
        batch = u[len(ratios) : len(ratios) + n_batch]
        parts.append(ask(batch))
        ratios = np.append(ratios, posterior.at(batch, parts[-1].mse) - expected(batch))
        if is_given_up(ratios):
            break
    return joined(parts), ratios


def most_probable(posterior: Posterior, rows: Evaluation) -> Evaluation:
    """Return the one of some rows that has the greatest density."""
    return rows.take(int(np.argmax(posterior.at(rows.u, rows.mse))))


def agrees(ratios: FloatArray, n_batch: int) -> bool:
    """Return whether a sample is worth enough.

    Args:
        ratios: Logarithms of the model's density over the predicted one. Shape (n,). [1]
        n_batch: Members up to which it is a first batch, which has to be worth more.
    """
    share = effective_size(normalized(ratios)) / len(ratios)
    # Where all failed the weights are equal, and their share alone would be perfect.
    return bool(np.isfinite(ratios).any()) and share >= AGREEMENT[len(ratios) > n_batch]


def decimals_for(steepness: float) -> int:
    """Return to how many decimals points are rounded.

    Args:
        steepness: One over the smallest deviation of a parameter, the others held. [1]
    """
    return max(DECIMALS, math.ceil(math.log10(STEPS_PER_DEVIATION * steepness)))
