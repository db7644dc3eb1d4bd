"""One counter for all methods: it stands between a method and the model, and ends a run."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from time import process_time
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from simulation import CountingModel, Trajectories
from simulation.arrays import FloatArray
from simulation.counting import BudgetExceeded
from simulation.forward_model import WrappedModel
from studies.calibration.problem import CalibrationProblem

# Far above the best error that is known a history keeps steps of this size, near it every improvement.
COARSE_STEP = 0.02
NEAR = 1.25


class TargetReachedError(Exception):
    """The target is reached; nothing more needs to be simulated."""


class WatchedModel(WrappedModel):
    """A model that notes the best error over the rows paid for, whoever asks.

    A batch is one entry: its rows were bought together.
    """

    def __init__(
        self, problem: CalibrationProblem, *, max_calls: int, target: float, at_once: int = 1
    ) -> None:
        """Begin at zero.

        Args:
            problem: The problem whose model is watched.
            max_calls: Most rows; the batch beyond is refused and simulates nothing.
            target: Error at which the run is over. [first output's unit squared]
            at_once: Rows that are simulated side by side, in a round.
        """
        self.watched = problem.model
        self._alone_before = self._alone
        self._counter = CountingModel(problem.model, budget=max_calls)
        super().__init__(self._counter)
        self._measurement = problem.measurement
        self._target = target
        self._at_once = at_once
        self.best_mse = float("inf")
        self.n_rounds = 0
        self.entries: list[tuple[int, float, int]] = []

    @property
    def n_calls(self) -> int:
        """Rows asked for, those that simulations of single experiments are worth among them."""
        return self._counter.n_calls + math.ceil(self._alone - self._alone_before)

    @property
    def _alone(self) -> float:
        return float(getattr(self.watched, "rows_alone", 0.0))

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Simulate, count and note.

        Raises:
            BudgetExceeded: The rows do not fit into the budget.
            TargetReachedError: The rows have reached the target.
        """
        if self.best_mse <= self._target:
            raise TargetReachedError
        answer = self._counter.simulate(theta)
        self.n_rounds += math.ceil(len(theta) / self._at_once)
        mse = float(self._measurement.mse(answer.y).min())
        if mse < self.best_mse:
            self.best_mse = mse
            self.entries.append((self.n_calls, mse, self.n_rounds))
        if mse <= self._target:
            raise TargetReachedError
        return answer


class Asked:
    """A problem as a peer sees it: functions of one point of the unit cube that never fail.

    A row that cannot be simulated is worse than the worst that could, and finite: most peers stop at anything
    else.
    """

    def __init__(self, problem: CalibrationProblem) -> None:
        """Take the problem, its model watched."""
        self._problem = problem
        self._worst = 1.0
        self._n_residuals = problem.measurement.n_samples
        self.n_parameters = problem.space.n_parameters

    def residuals(self, u: FloatArray) -> FloatArray:
        """Return signed residuals. Shape (m,). [first output's unit]."""
        answer = self._problem.evaluate(np.clip(u, 0.0, 1.0))
        if answer.failures[0]:
            return np.full(self._n_residuals, np.sqrt(10.0 * self._worst))
        self._worst = max(self._worst, float(answer.mse[0]))
        return np.asarray(answer.residuals[0])

    def mse(self, u: FloatArray) -> float:
        """Return the mean squared error. [first output's unit squared]."""
        return float(np.mean(self.residuals(u) ** 2))

    def log_mse(self, u: FloatArray) -> float:
        """Return its natural logarithm, which is less curved far from the optimum."""
        return float(np.log(max(self.mse(u), 1e-300)))


@dataclass(frozen=True)
class Run:
    """One run of one method on one problem, as it is kept.

    Attributes:
        calls: Rows paid for where the best error fell. Length h.
        mse: Best error then. Length h. [first output's unit squared]
        rounds: Rounds until then: rows that are simulated side by side are one. Length h.
        n_calls: Rows in all.
        max_calls: The budget.
        ended: "target", "budget", "method" or what went wrong.
        seconds: Processor time with all simulations. [s]
        said: Why it ended, in the method's own words; of peers empty.
        converged: Whether it said that it converged; of peers None.
    """

    calls: list[int]
    mse: list[float]
    rounds: list[int]
    n_calls: int
    max_calls: int
    ended: str
    seconds: float
    said: str = ""
    converged: bool | None = None

    def first(self, target: float) -> int | None:
        """Return where in the history the error first was at most the target, None if nowhere."""
        return next((i for i, mse in enumerate(self.mse) if mse <= target * (1.0 + 1e-6)), None)

    def calls_to(self, target: float) -> float:
        """Return the rows paid for until the target, infinite if never."""
        index = self.first(target)
        return float("inf") if index is None else float(self.calls[index])

    def rounds_to(self, target: float) -> float:
        """Return the rounds until the target, infinite if never."""
        index = self.first(target)
        return float("inf") if index is None else float(self.rounds[index])

    def is_complete(self, target: float | None, max_calls: int) -> bool:
        """Say whether a run with this target and budget would not have gone on beyond it.

        Args:
            target: Error at which the benchmark ends a run, None where the method ends by itself.
            max_calls: The budget.
        """
        if self.ended not in ("target", "budget", "method"):
            return True
        if target is None:
            return bool(self.said) and (self.ended == "method" or self.max_calls >= max_calls)
        if self.first(target) is not None or self.ended == "method":
            return True
        return self.ended == "budget" and self.max_calls >= max_calls


def kept_history(entries: list[tuple[int, float, int]], best: float) -> list[tuple[int, float, int]]:
    """Return the entries that a table or a picture can distinguish."""
    kept: list[tuple[int, float, int]] = []
    for i, entry in enumerate(entries):
        is_last = i == len(entries) - 1
        if not kept or is_last or entry[1] <= NEAR * best or entry[1] <= (1.0 - COARSE_STEP) * kept[-1][1]:
            kept.append(entry)
    return kept


@contextmanager
def one_thread() -> Iterator[None]:
    """Let linear algebra use one thread: matrices are small, and runs are timed beside each other."""
    with threadpool_limits(limits=1):
        yield


def run_once(
    method: Any,
    problem: CalibrationProblem,
    seed: int,
    *,
    max_calls: int,
    best: float,
    factor: float | None,
    at_once: int = 1,
) -> Run:
    """Run a method until the target, its budget or its own end.

    Args:
        method: Called with the watched problem, the seed and the budget.
        problem: The problem.
        seed: Seed of the run.
        max_calls: Most rows.
        best: Best error known. [first output's unit squared]
        factor: The target as a multiple of it, None for none: the method ends by itself.
        at_once: Rows that make a round.
    """
    target = -math.inf if factor is None else factor * best
    watched = WatchedModel(problem, max_calls=max_calls, target=target, at_once=at_once)
    began, ended, found = process_time(), "method", None
    try:
        with one_thread():
            found = method(problem.on(watched), seed, max_calls)
    except TargetReachedError:
        ended = "target"
    except BudgetExceeded:
        ended = "budget"
    except Exception as error:  # A peer that breaks is a result; the benchmark goes on.
        ended = f"{type(error).__name__}: {error}".splitlines()[0][:200]
    if ended == "method" and watched.n_calls >= max_calls and not getattr(found, "converged", False):
        ended = "budget"
    history = kept_history(watched.entries, best)
    return Run(
        calls=[entry[0] for entry in history],
        mse=[float(f"{entry[1]:.7g}") for entry in history],
        rounds=[entry[2] for entry in history],
        n_calls=watched.n_calls,
        max_calls=max_calls,
        ended=ended,
        seconds=round(process_time() - began, 2),
        said=getattr(found, "stop_reason", ""),
        converged=getattr(found, "converged", None),
    )
