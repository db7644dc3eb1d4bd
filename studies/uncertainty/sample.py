"""A sample of equally good parameter sets: drawn on a surrogate, simulated by the model, reweighted by it.

Rounds: a Gaussian process of the residuals is fitted to all rows known near the optimum, a Markov chain
samples the density that it predicts, and a batch of the chain is simulated. So are some scouts: points of the
same density, flattened, because a sample never tells of a region that its surrogate holds for bad. Where the
model disagrees with the prediction by too much, or a scout turns out to be as good as the sample against all
expectation, the batch teaches the process and the next round begins; where all agree, the same chain is
simulated further until the sample is large enough. Each of its members then weighs as much as the
model's density exceeds the predicted one (importance sampling): so the sample is the model's.

Rows follow from problem, known rows, settings and seed alone: repeated over stored simulations, a sampling
goes on where it stopped.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from simulation.arrays import FloatArray
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.residual_process import Features, ResidualProcess
from studies.uncertainty.chain import Chain, run_chain
from studies.uncertainty.density import Posterior, Predicted
from studies.uncertainty.rows import joined, telling_rows
from studies.uncertainty.weights import effective_size, normalized

DECIMALS = 5
"""Points are rounded to this many decimals of the unit cube, so that a store finds them again."""

AGREEMENT = 0.5
"""A batch that is worth this share of its size by its weights agrees with the surrogate."""

LOST = 0.4
"""A sample whose worth falls below this share of its size is given up while calls are left."""

FLATTENED = 4.0
"""The scouts' density is the predicted one to the power 1 / 4: twice as wide."""

SURPRISE, AS_GOOD = 2.0, 3.0
"""A scout whose logarithmic density exceeds the prediction by more than the first, beyond what the sample's
does, and lies no further below the sample's median than the second, is as good against expectation."""


@dataclass(frozen=True)
class Sampling:
    """How a posterior is sampled.

    Attributes:
        max_calls: Most rows that may be asked of the model.
        n_sample: Size of the sample that is simulated.
        n_batch: Rows per round.
        n_scouts: Rows per round beside the sample.
        n_steps: Steps of every walker of a chain.
    """

    max_calls: int
    n_sample: int = 48
    n_batch: int = 8
    n_scouts: int = 4
    n_steps: int = 1500


@dataclass(frozen=True, eq=False)
class PosteriorSample:
    """Equally good parameter sets.

    Attributes:
        drawn: The sample as the model answered. n rows.
        weights: What each counts; sum 1. Shape (n,). [1]
        log_ratios: Logarithm of the model's density over the predicted one. Shape (n,). [1]
        chain: A chain on the last surrogate, which knows every simulated row.
        n_calls: Rows asked of the model.
        n_taught: Those of them that are not in the sample: they taught the surrogate.
        n_known: Rows known before.
        best_u: The most probable row of all, asked or known before. Shape (p,). [1]
        best_mse: Its error. [first output's unit squared]
    """

    drawn: Evaluation
    weights: FloatArray
    log_ratios: FloatArray
    chain: Chain
    n_calls: int
    n_taught: int
    n_known: int
    best_u: FloatArray
    best_mse: float

    @property
    def n_effective(self) -> float:
        """Members of equal weight that the sample is worth."""
        return effective_size(self.weights)


OnCalls = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class _Answered:
    """Logarithmic densities of simulated points: by the model, and as they were predicted. Shape (n,)."""

    density: FloatArray
    predicted: FloatArray

    @property
    def ratios(self) -> FloatArray:
        """Logarithm of the one over the other. Shape (n,). [1]."""
        return self.density - self.predicted

    def with_more(self, more: "_Answered") -> "_Answered":
        """Return both together."""
        return _Answered(np.append(self.density, more.density), np.append(self.predicted, more.predicted))


class PosteriorSampler:
    """The rows of one sampling."""

    def __init__(
        self,
        problem: CalibrationProblem,
        posterior: Posterior,
        settings: Sampling,
        known: Evaluation,
        *,
        seed: int,
        on_calls: OnCalls | None = None,
    ) -> None:
        """Begin with what is known.

        Args:
            problem: The problem, posed to the physical model.
            posterior: The density.
            settings: How to sample.
            known: Rows that are known already.
            seed: Seed of all draws.
            on_calls: Told how many rows were asked so far.
        """
        self._problem, self._posterior, self._settings = problem, posterior, settings
        self._features = Features.of(problem.space)
        self._rng = np.random.default_rng(seed)
        self._on_calls = on_calls
        self._u, self._mse, self._residuals = known.u, known.mse, known.residuals
        self._hyper: FloatArray | None = None
        self._n_known = known.n
        self._ensemble: FloatArray | None = None
        self.n_calls = 0

    def sample(self, first: FloatArray) -> PosteriorSample:
        """Sample the posterior.

        Args:
            first: First places of the walkers, inside the cube. Shape (w, p). [1]
        """
        self._ensemble = first
        with threadpool_limits(limits=1, user_api="blas"):
            while True:
                predicted, chain = self._round()
                scouts = self._scout(predicted)
                drawn, ratios, is_good = self._simulate(predicted, chain, scouts)
                if is_good or not self._has_another_round:
                    break
            _, last = self._round()
        density = self._posterior.at(self._u, self._mse)
        best = int(np.argmax(density))
        return PosteriorSample(
            drawn=drawn,
            weights=normalized(ratios),
            log_ratios=ratios,
            chain=last,
            n_calls=self.n_calls,
            n_taught=self.n_calls - drawn.n,
            n_known=self._n_known,
            best_u=self._u[best],
            best_mse=float(self._mse[best]),
        )

    def _round(self) -> tuple[Predicted, Chain]:
        """Fit the process to what is known and sample the density that it predicts."""
        rows = telling_rows(self._u, self._posterior.at(self._u, self._mse))
        process = ResidualProcess.fit(self._features, self._u[rows], self._residuals[rows], self._hyper)
        self._hyper = process.hyper
        assert self._ensemble is not None, "sample() places the walkers"
        predicted = Predicted(process)
        chain = run_chain(
            lambda u: self._posterior.by(predicted, u),
            self._ensemble,
            seed=int(self._rng.integers(2**31)),
            n_steps=self._settings.n_steps,
            metric=lambda u: self._posterior.metric(predicted, u),
        )
        self._ensemble = chain.ensemble
        return predicted, chain

    @property
    def _has_another_round(self) -> bool:
        """Whether the calls that are left allow scouts and a sample of two batches."""
        left = self._settings.max_calls - self.n_calls
        return left >= 2 * self._settings.n_batch + self._settings.n_scouts

    def _scout(self, predicted: Predicted) -> "_Answered":
        """Simulate points of the flattened density, if the calls allow."""
        settings = self._settings
        if not settings.n_scouts or not self._has_another_round:
            return _Answered(np.empty(0), np.empty(0))
        assert self._ensemble is not None, "sample() places the walkers"
        wide = run_chain(
            lambda u: self._posterior.by(predicted, u) / FLATTENED,
            self._ensemble,
            seed=int(self._rng.integers(2**31)),
            n_steps=settings.n_steps // 2,
            metric=lambda u: self._posterior.metric(predicted, u) / FLATTENED,
        )
        u = np.round(self._rng.choice(wide.u, settings.n_scouts, replace=False), DECIMALS)
        return _Answered(self._posterior.at(u, self._ask(u).mse), self._posterior.by(predicted, u))

    def _simulate(
        self, predicted: Predicted, chain: Chain, scouts: "_Answered"
    ) -> tuple[Evaluation, FloatArray, bool]:
        """Simulate members of a chain as long as the model agrees.

        Args:
            predicted: What the surrogate predicts.
            chain: A chain on it.
            scouts: What the model answered to the scouts.

        Returns:
            The members, the logarithms of the model's density over the predicted one, and whether they agree.
        """
        settings = self._settings
        order = self._rng.permutation(len(chain.u))
        parts: list[Evaluation] = []
        answered = _Answered(np.empty(0), np.empty(0))
        while True:
            n_have = len(answered.density)
            n = min(settings.n_batch, settings.max_calls - self.n_calls, settings.n_sample - n_have)
            if n <= 0:
                break
            u = np.round(chain.u[order[n_have : n_have + n]], DECIMALS)
            answer = self._ask(u)
            parts.append(answer)
            new = _Answered(self._posterior.at(u, answer.mse), self._posterior.by(predicted, u))
            answered = answered.with_more(new)
            if self._has_another_round and not self._agrees(answered, scouts):
                break
        return joined(parts), answered.ratios, self._agrees(answered, scouts)

    def _agrees(self, sample: "_Answered", scouts: "_Answered") -> bool:
        """Whether a sample is worth enough, and no scout is as good as it against expectation."""
        n = len(sample.density)
        share = effective_size(normalized(sample.ratios)) / n
        good = np.isfinite(sample.density)
        if share < (AGREEMENT if n <= self._settings.n_batch else LOST) or not good.any():
            return False
        beyond = scouts.ratios - float(np.median(sample.ratios[good]))
        level = float(np.median(sample.density[good])) - AS_GOOD
        return not np.any((beyond > SURPRISE) & (scouts.density > level))

    def _ask(self, u: FloatArray) -> Evaluation:
        answer = self._problem.evaluate(u)
        self.n_calls += len(u)
        self._u = np.concatenate([self._u, answer.u])
        self._mse = np.concatenate([self._mse, answer.mse])
        self._residuals = np.concatenate([self._residuals, answer.residuals])
        if self._on_calls is not None:
            self._on_calls(self.n_calls)
        return answer


def first_walkers(centre: FloatArray, covariance: FloatArray, n: int, rng: np.random.Generator) -> FloatArray:
    """Return places in the cube, normal around a point; what falls outside is thrown back.

    Args:
        centre: Shape (p,). [1]
        covariance: Shape (p, p). [1]
        n: How many.
        rng: Source of the draws.

    Returns:
        Shape (n, p). [1]
    """
    drawn = rng.multivariate_normal(centre, covariance, size=n)
    folded = np.abs(drawn) % 2.0
    inside: FloatArray = np.where(folded > 1.0, 2.0 - folded, folded)
    return inside
