"""Residuals that cost no simulation: of state equations where they are known, else of a Gaussian process."""

from dataclasses import replace

import numpy as np

from simulation.arrays import FloatArray
from simulation.forward_model import ForwardModel
from studies.calibration.descent import Residuals
from studies.calibration.prior import Prior
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.processes.kernel import between
from studies.calibration.processes.process import Features, ResidualProcess
from studies.calibration.uncertainty.noise import Noise
from studies.calibration.uncertainty.rows import informative_rows


def emulated_residuals(
    problem: CalibrationProblem, known: Evaluation, emulator: ForwardModel | None
) -> Residuals:
    """Return what gives the residuals of points (n, p), shape (n, m), without a simulation. [unit].

    Args:
        problem: The problem.
        known: Rows that were simulated, at least two good ones.
        emulator: The model's state equations; None for a process that is fitted to the rows.
    """
    if emulator is not None:
        return problem.on(emulator).residuals
    rows = informative_rows(known.u, -known.mse)
    u, residuals, features = known.u[rows], known.residuals[rows], Features.of(problem.space)
    process = ResidualProcess.fit(features, u, residuals)
    # The mean of the process in the samples themselves: its own basis is of the rows' differences.
    weights = process.inverse_factor.T @ (process.inverse_factor @ (residuals - residuals[0]))

    def predicted(at: FloatArray) -> FloatArray:
        k = between(features.at(np.clip(at, 0.0, 1.0)), process.x, process.hyper)
        return np.asarray(residuals[0] + k @ weights)

    return predicted


def weighed(prior: Prior | None, noise: Noise) -> Prior | None:
    """Return a prior that weighs against the noise as in the posterior, not against the declared sensor."""
    return None if prior is None else replace(prior, weight=noise.unit)
