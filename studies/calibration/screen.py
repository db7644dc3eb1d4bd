"""Screening: SciPy's differential evolution over the whole box, a generation per batch."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import Bounds, OptimizeResult, differential_evolution

from simulation.arrays import FloatArray
from simulation.counting import BudgetExceeded
from simulation.errors import InputError
from studies.calibration.problem import CalibrationProblem
from studies.calibration.recorder import OnProgress, Recorder, SearchResult


@dataclass(frozen=True)
class ScreenResult(SearchResult):
    """The best point of the box and the population around it; converged where that hardly differs.

    Attributes:
        population_u: Last population, best first. Shape (s, p). [1]
    """

    population_u: FloatArray


@dataclass(frozen=True)
class DifferentialEvolution:
    """Differential evolution in the unit cube (doi 10.1023/A:1008202821328), without a hidden polish.

    Attributes:
        popsize: Population per parameter, at least 5 in all; the Sobol start rounds it up to a power of two.
        maxiter: Most generations after the first population.
        tol: Stop when the population's standard deviation falls below this fraction of its mean error.
        margin: Part of each coordinate's range that is left out at both ends, for a surrogate that predicts
            worse toward the bounds (Aka et al. 2023, sec. 3.2). [1]
        max_calls: Most rows that may be asked of the model, or None: for use on a physical model.
    """

    popsize: int = 8
    maxiter: int = 200
    tol: float = 1e-3
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
        population, objectives = np.empty((0, p)), np.empty(0)

        def objective(columns: FloatArray) -> FloatArray:
            """Return the objectives (S,) of a generation, which SciPy hands over as (p, S)."""
            nonlocal population, objectives
            answer = recorder.evaluate(columns.T)
            # A budget may end before the first generation does; then the first population is the result.
            if not objectives.size:
                population, objectives = answer.u.copy(), answer.objective.copy()
            return answer.objective

        def keep(intermediate_result: OptimizeResult) -> None:
            """Remember the points that a generation has ended with, and their errors."""
            nonlocal population, objectives
            population = np.array(intermediate_result.population)
            objectives = np.array(intermediate_result.population_energies)

        # SciPy's stubs describe the function of one point only, not the vectorized one.
        vectorized: Any = objective
        converged = False
        try:
            found = differential_evolution(
                vectorized,
                bounds=Bounds(np.full(p, self.margin), np.full(p, 1.0 - self.margin)),
                maxiter=self.maxiter,
                popsize=self.popsize,
                tol=self.tol,
                rng=np.random.default_rng(seed),
                callback=keep,
                # A polish would ask for differences row by row, beyond what is counted as generations.
                polish=False,
                init="sobol",
                # A generation is one batch for the model, so that no member may see the others' progress.
                updating="deferred",
                vectorized=True,
            )
            converged = bool(found.success)
            keep(found)
            reason = "the population has converged" if converged else "the limit of generations is reached"
        except BudgetExceeded as end:
            reason = str(end)
        best_first = population[np.argsort(objectives, kind="stable")]
        return recorder.result(ScreenResult, reason, converged=converged, population_u=best_first)
