"""How much each parameter matters to what is compared: by Sobol indices, or Morris' elementary effects."""

from dataclasses import dataclass

import numpy as np
from SALib.sample import morris as salib_morris

from simulation.arrays import FloatArray
from simulation.measurement import Measurement
from studies.calibration.problem import CalibrationProblem
from studies.sensitivity import SobolIndices

N_LEVELS = 4


@dataclass(frozen=True, eq=False)
class Relevance:
    """Shares of the parameters in what varies among the outputs.

    Attributes:
        names: Names of the p parameters.
        shares: Each one's share, NaN where it could not be found. Shape (p,). [1]
        source: "Sobol" or "Morris".
        n_calls: Rows asked of the model for it.
    """

    names: tuple[str, ...]
    shares: FloatArray
    source: str
    n_calls: int

    def most(self, n: int) -> tuple[str, ...]:
        """Return the n most relevant parameters in the case's order; an unknown one counts as relevant."""
        order = np.argsort(-np.nan_to_num(self.shares, nan=np.inf), kind="stable")
        return tuple(self.names[j] for j in sorted(order[:n]))


def sobol_relevance(indices: SobolIndices, measurement: Measurement) -> Relevance:
    """Return the shares in the variance of all outputs, by total order, weighed as the error weighs outputs.

    Args:
        indices: Sobol indices of the case.
        measurement: What the outputs are compared with.
    """
    by_output = measurement.weights * (measurement.uncertainty[0] / measurement.uncertainty) ** 2
    variance = np.nan_to_num(indices.variance) * by_output
    parts = np.einsum("tk,tkp->p", variance, np.nan_to_num(indices.total_order))
    return Relevance(indices.names, _shares(np.maximum(parts, 0.0)), "Sobol", indices.n_calls)


def morris_design(p: int, n_trajectories: int, seed: int) -> FloatArray:
    """Return Morris' trajectories: p steps each, every one of another parameter (doi 10.2307/1269043).

    Args:
        p: Parameters.
        n_trajectories: Trajectories r.
        seed: Seed of the trajectories.

    Returns:
        Points of the unit cube, trajectory after trajectory. Shape (r (p + 1), p). [1]
    """
    declared = {"num_vars": p, "names": [f"u{j}" for j in range(p)], "bounds": [[0.0, 1.0]] * p}
    rng = np.random.default_rng(seed)
    return np.asarray(salib_morris.sample(declared, n_trajectories, num_levels=N_LEVELS, seed=rng))


def morris_relevance(problem: CalibrationProblem, *, n_trajectories: int, seed: int) -> Relevance:
    """Return the shares in the mean square of all elementary effects on the residuals.

    An effect is the change of the residuals along one step over its length, in the calibration's coordinates.
    A parameter none of whose steps could be simulated is unknown.

    Args:
        problem: The problem, posed to the physical model.
        n_trajectories: Trajectories; each costs a row per parameter and one more.
        seed: Seed of the trajectories.
    """
    p = problem.space.n_parameters
    u = morris_design(p, n_trajectories, seed)
    residuals = problem.evaluate(u).residuals
    squares: list[list[float]] = [[] for _ in range(p)]
    for first in range(len(u) - 1):
        if (first + 1) % (p + 1) == 0:
            continue  # The next row begins another trajectory.
        step = u[first + 1] - u[first]
        j = int(np.argmax(np.abs(step)))
        effect = (residuals[first + 1] - residuals[first]) / step[j]
        if np.isfinite(effect).all():
            squares[j].append(float(np.mean(effect**2)))
    parts = np.array([np.mean(found) if found else np.nan for found in squares])
    return Relevance(problem.space.names, _shares(parts), "Morris", len(u))


def _shares(parts: FloatArray) -> FloatArray:
    total = float(np.nansum(parts))
    return parts / total if total > 0.0 else parts
