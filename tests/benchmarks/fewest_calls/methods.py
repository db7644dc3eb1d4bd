"""The methods that are compared, each at its best settings, none with an initial guess.

Not here: the paper's own method. paper_method.py measures it, whole studies with their trainings.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec

from fewest_calls import peers_bayesian, peers_least_squares, peers_modestpy, peers_scalar
from studies.calibration.problem import CalibrationProblem
from studies.calibration.search.adaptive import Adaptive, AdaptiveResult

Search = Callable[[CalibrationProblem, int, int], AdaptiveResult | None]
"""Problem, seed and most calls; asks the problem's model. Ours return how they ended, peers nothing."""


@dataclass(frozen=True)
class Method:
    """A way to calibrate.

    Attributes:
        search: How.
        max_calls: Budget of a run unless the command line says otherwise.
        seeds: Runs per problem unless the command line says otherwise: fewer where a run costs minutes.
        needs: Packages, as Python imports them.
        variable: Environment variable without which it cannot run.
        is_ours: Whether it is this project's: it ends by itself, as the command does, not at the target.
        at_once: Rows that it asks in a round; where more than one, rounds count beside calls.
    """

    search: Search
    max_calls: int = 1000
    seeds: int = 10
    needs: tuple[str, ...] = ()
    variable: str = ""
    is_ours: bool = False
    at_once: int = 1

    @property
    def missing(self) -> list[str]:
        """Packages that are not installed, and the variable that is not set."""
        missing = [name for name in self.needs if find_spec(name) is None]
        if self.variable and self.variable not in os.environ:
            missing.append(f"${self.variable}")
        return missing


def adaptive(n_parallel: int = 1, *, state_equations: bool = False) -> Search:
    """Return the adaptive method with the command's own settings; it ends by itself."""

    def search(problem: CalibrationProblem, seed: int, max_calls: int) -> AdaptiveResult:
        sensor = float(problem.measurement.uncertainty[0])
        chosen = Adaptive.for_sensor(sensor, max_calls=max_calls, n_parallel=n_parallel)
        watched = problem.model.watched  # type: ignore[attr-defined]
        if not state_equations:
            return chosen.minimize(problem, seed=seed, network_inputs=watched.network_inputs)
        return chosen.minimize(problem, seed=seed, learned_ode=watched.learned_ode(problem))

    return search


METHODS: dict[str, Method] = {
    "adaptive": Method(adaptive(), max_calls=300, is_ours=True),
    "adaptive, state equations": Method(adaptive(state_equations=True), max_calls=300, is_ours=True),
    **{
        f"adaptive, state equations, {q} parallel": Method(
            adaptive(q, state_equations=True), max_calls=300, is_ours=True, at_once=q
        )
        for q in (2, 4, 8)
    },
    **{
        f"adaptive, {q} parallel": Method(adaptive(q), max_calls=300, is_ours=True, at_once=q)
        for q in (2, 4, 8)
    },
    "broyden": Method(peers_least_squares.broyden),
    "dfols": Method(peers_least_squares.dfols, needs=("dfols",)),
    "trf": Method(peers_least_squares.trf),
    "trf, paper": Method(peers_least_squares.trf_as_in_the_paper, max_calls=5000),
    "botorch": Method(
        peers_bayesian.botorch_composite, max_calls=100, seeds=2, needs=("botorch", "gpytorch")
    ),
    "bobyqa": Method(peers_scalar.bobyqa, max_calls=1500, seeds=3, needs=("pybobyqa",)),
    "modestpy": Method(peers_modestpy.modestpy, variable=peers_modestpy.PYTHON),
    "nelder-mead": Method(peers_scalar.nelder_mead, max_calls=5000),
    "cma-es": Method(peers_scalar.cma_es, max_calls=5000, needs=("cma",)),
    "differential evolution": Method(peers_scalar.differential_evolution, max_calls=5000),
    "optuna tpe": Method(peers_scalar.optuna_tpe, max_calls=500, seeds=3),
    "optuna gp": Method(peers_scalar.optuna_gp, max_calls=150, seeds=3),
    "optuna cma-es": Method(peers_scalar.optuna_cma_es, max_calls=2000, seeds=5, needs=("cmaes",)),
}
