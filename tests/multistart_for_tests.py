"""LS-TRF straight on a model from many starts: what tests and benchmarks compare calibrations with."""

from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.polish import LeastSquaresTRF, PolishResult
from studies.calibration.problem import CalibrationProblem


@dataclass(frozen=True)
class MultistartResult:
    """LS-TRF from several starting points.

    Attributes:
        starts: Starting points in the unit cube. Shape (s, p). [1]
        runs: What each of them came to, in the same order.
    """

    starts: FloatArray
    runs: tuple[PolishResult, ...]

    @property
    def best(self) -> PolishResult:
        """The run with the lowest objective; the first of equals."""
        return min(self.runs, key=lambda run: run.objective)

    @property
    def mse(self) -> FloatArray:
        """Final error of every run. Shape (s,). [first output's unit squared]."""
        return np.array([run.mse for run in self.runs])

    @property
    def n_calls(self) -> int:
        """Rows asked of the model in all."""
        return sum(run.n_calls for run in self.runs)

    def calls_to(self, target: float) -> list[int | None]:
        """Return for every run the rows asked when its error first was at most `target`, None if never."""
        return [run.history.calls_to(target) for run in self.runs]


def multistart(
    problem: CalibrationProblem,
    n_starts: int,
    seed: int,
    *,
    polishing: LeastSquaresTRF | None = None,
) -> MultistartResult:
    """Polish from starting points drawn uniformly in the unit cube.

    Start i depends on the seed and i alone: more starts extend fewer.

    Args:
        problem: The problem, posed to the model that is asked.
        n_starts: Number of starting points.
        seed: Seed of the starting points.
        polishing: Settings of each run; the defaults when not given.

    Returns:
        All runs.
    """
    polishing = polishing or LeastSquaresTRF()
    starts = np.random.default_rng(seed).random((n_starts, problem.space.n_parameters))
    return MultistartResult(starts, tuple(polishing.minimize(problem, u0) for u0 in starts))


def best_known(problem: CalibrationProblem, n_starts: int = 24, seed: int = 0) -> MultistartResult:
    """Find the best error that brute force can reach: multistart with patience and tight tolerances.

    Args:
        problem: The problem, posed to the physical model.
        n_starts: Number of starting points; when nearly all end at the same error, it is the best.
        seed: Seed of the starting points.
    """
    patient = LeastSquaresTRF(ftol=1e-9, xtol=1e-10, max_calls=20_000)
    return multistart(problem, n_starts, seed, polishing=patient)
