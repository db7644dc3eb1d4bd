"""Screening: SciPy's differential evolution over the whole box, a generation per batch."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.optimize import Bounds, OptimizeResult, differential_evolution

from simulation.arrays import FloatArray
from simulation.counting import BudgetExceeded
from simulation.errors import InputError
from studies.calibration.problem import CalibrationProblem
from studies.calibration.recorder import History, OnProgress, Recorder


@dataclass(frozen=True)
class ScreenResult:
    """The best point of the box and the population around it.

    Attributes:
        u: Best point in the unit cube. Shape (p,). [1]
        theta: The same as parameters. Shape (p,). [per parameter]
        y: The screened model's trajectory there. Shape (t, k). [output's unit]
        mse: The screened model's error there, infinite when every row failed. [first output's unit squared]
        population_u: Last population, best first. Shape (s, p). [1]
        population_objective: Its errors, a prior's penalty included, rising. Shape (s,). [same]
        n_evaluations: Rows asked of the model.
        n_generations: Generations after the first population.
        history: Best MSE over rows asked, an entry per generation.
        stop_reason: Why it ended, in words.
        converged: True when the population's spread fell below the tolerance.
    """

    u: FloatArray
    theta: FloatArray
    y: FloatArray
    mse: float
    population_u: FloatArray
    population_objective: FloatArray
    n_evaluations: int
    n_generations: int
    history: History
    stop_reason: str
    converged: bool


@dataclass(frozen=True)
class DifferentialEvolution:
    """Differential evolution in the unit cube (doi 10.1023/A:1008202821328), without a hidden polish.

    Attributes:
        popsize: Population per parameter, at least 5 in all; the Sobol start rounds it up to a power of two.
        maxiter: Most generations after the first population.
        tol: Stop when the population's standard deviation falls below this fraction of its mean error.
        strategy: SciPy's name of the mutation; "best1bin" is greedy, "rand1bin" slower and more thorough.
        mutation: Range from which each generation draws its differential weight. [1]
        recombination: Probability that a coordinate comes from the mutant. [1]
        margin: Part of each coordinate's range that is left out at both ends, for a surrogate that predicts
            worse toward the bounds (Aka et al. 2023, sec. 3.2). [1]
        max_calls: Most rows that may be asked of the model, or None: for use on a physical model.
    """

    popsize: int = 8
    maxiter: int = 200
    tol: float = 1e-3
    strategy: Literal["best1bin", "rand1bin", "currenttobest1bin", "randtobest1bin"] = "best1bin"
    mutation: tuple[float, float] = (0.5, 1.0)
    recombination: float = 0.7
    margin: float = 0.0
    max_calls: int | None = None

    def __post_init__(self) -> None:
        """Refuse settings that no search can run with."""
        if self.popsize < 1 or self.maxiter < 0:
            raise InputError(
                f"screening: popsize is {self.popsize} and maxiter {self.maxiter}; give at least 1 and 0"
            )
        if not 0.0 <= self.margin < 0.5:
            raise InputError(f"screening: margin is {self.margin}; give a value in [0, 0.5)")

    def minimize(
        self, problem: CalibrationProblem, *, seed: int, on_progress: OnProgress | None = None
    ) -> ScreenResult:
        """Search the whole box.

        Args:
            problem: The problem, posed to the model that is asked.
            seed: Seed of the population and all draws.
            on_progress: Called after each generation.

        Returns:
            The best point seen; never raises for failed rows or a spent budget.

        Raises:
            InputError: The budget does not even hold the first population.
        """
        p = problem.space.n_parameters
        # SciPy rounds a Sobol start up to a power of two, for which these points are balanced.
        n_population = 1 << (max(5, self.popsize * p) - 1).bit_length()
        if self.max_calls is not None and self.max_calls < n_population:
            raise InputError(
                f"screening: max_calls is {self.max_calls}, the first population has {n_population} rows; "
                "raise max_calls or lower popsize"
            )
        recorder = Recorder(
            problem,
            phase="screen",
            max_calls=self.max_calls,
            n_total=n_population * (self.maxiter + 1),
            on_progress=on_progress,
        )
        search = _Search(recorder)
        # SciPy's stubs describe the function of one point only, not the vectorized one.
        objective: Any = search.objective
        converged = False
        try:
            found = differential_evolution(
                objective,
                bounds=Bounds(np.full(p, self.margin), np.full(p, 1.0 - self.margin)),
                strategy=self.strategy,
                maxiter=self.maxiter,
                popsize=self.popsize,
                tol=self.tol,
                mutation=self.mutation,
                recombination=self.recombination,
                rng=np.random.default_rng(seed),
                callback=search.keep_population,
                # A polish would ask for differences row by row, beyond what is counted as generations.
                polish=False,
                init="sobol",
                # A generation is one batch for the model, so that no member may see the others' progress.
                updating="deferred",
                vectorized=True,
            )
            converged = bool(found.success)
            search.keep_population(found)
            reason = "the population has converged" if converged else "the limit of generations is reached"
        except BudgetExceeded as end:
            reason = str(end)
        best = recorder.best
        assert best is not None, "the budget holds the first population"
        order = np.argsort(search.population_objective, kind="stable")
        return ScreenResult(
            u=best.u[0],
            theta=best.theta[0],
            y=best.y[0],
            mse=float(best.mse[0]),
            population_u=search.population_u[order],
            population_objective=search.population_objective[order],
            n_evaluations=recorder.n_calls,
            n_generations=recorder.history.n_calls.size - 1,
            history=recorder.history,
            stop_reason=reason,
            converged=converged,
        )


class _Search:
    """The two callbacks of one differential evolution, and the population they have seen last."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.population_u: FloatArray = np.empty((0, 0))
        self.population_objective: FloatArray = np.empty(0)

    def objective(self, columns: FloatArray) -> FloatArray:
        """Return the objectives of a generation, which SciPy hands over as (p, S). Shape (S,)."""
        evaluation = self._recorder.evaluate(columns.T)
        # A budget may end before the first generation does; then the first population is the result.
        if not self.population_objective.size:
            self.population_u, self.population_objective = evaluation.u.copy(), evaluation.objective.copy()
        return evaluation.objective

    def keep_population(self, intermediate_result: OptimizeResult) -> None:
        """Remember the points that a generation has ended with, and their errors."""
        self.population_u = np.array(intermediate_result.population)
        self.population_objective = np.array(intermediate_result.population_energies)
