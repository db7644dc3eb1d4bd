"""Peers that see the residuals: LS-TRF, DFO-LS and Levenberg-Marquardt with Broyden's updates."""

from collections.abc import Callable

import numpy as np

from fewest_calls.counted import Asked
from simulation.arrays import FloatArray
from studies.calibration.polish import LeastSquaresTRF
from studies.calibration.problem import CalibrationProblem
from studies.calibration.search.first_design import latin_hypercube

N_SCREENED = 10
DIFFERENCE = 1e-5

Residuals = Callable[[FloatArray], FloatArray]


def trf_as_in_the_paper(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """LS-TRF on squared residuals in linear coordinates, from random starts until the budget is spent."""
    settings = LeastSquaresTRF(residuals="squared", ftol=1e-8, max_calls=max_calls)
    _from_random_starts(settings, problem, seed)


def trf(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """LS-TRF at its best: signed residuals, declared (logarithmic) coordinates, scaled by the Jacobian."""
    _from_random_starts(LeastSquaresTRF(ftol=1e-6, max_calls=max_calls), problem, seed)


def _from_random_starts(settings: LeastSquaresTRF, problem: CalibrationProblem, seed: int) -> None:
    rng = np.random.default_rng(seed)
    n_calls, max_calls = 0, settings.max_calls or 0
    while n_calls < max_calls:
        result = settings.minimize(problem, rng.random(problem.space.n_parameters))
        if "budget" in result.stop_reason:
            return
        n_calls += max(result.n_calls, 1)


def broyden(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """Levenberg-Marquardt with Broyden's updates from the best of ten points; again when it is stuck."""
    _screened_again_and_again(problem, seed, max_calls, _levenberg_marquardt)


def dfols(problem: CalibrationProblem, seed: int, max_calls: int) -> None:
    """DFO-LS (doi 10.1145/3338517) from the best of ten points; again when it has converged."""
    import dfols as peer

    def search(residuals: Residuals, u0: FloatArray) -> None:
        bounds = (np.zeros(u0.size), np.ones(u0.size))
        # It wants its first radius inside the box on both sides of the start.
        start = np.clip(u0, 0.1, 0.9)
        peer.solve(
            residuals, start, bounds=bounds, rhobeg=0.1, rhoend=1e-4, maxfun=max_calls, do_logging=False
        )

    _screened_again_and_again(problem, seed, max_calls, search)


def _screened_again_and_again(
    problem: CalibrationProblem, seed: int, max_calls: int, search: Callable[[Residuals, FloatArray], None]
) -> None:
    asked, rng, n_starts = Asked(problem), np.random.default_rng(seed), 0
    while n_starts < max_calls:
        design = latin_hypercube(N_SCREENED, asked.n_parameters, rng)
        errors = [float(np.mean(asked.residuals(u) ** 2)) for u in design]
        search(asked.residuals, design[int(np.argmin(errors))])
        n_starts += 1


def _levenberg_marquardt(residuals: Residuals, u: FloatArray) -> None:
    """Search until steps no longer move; differences only when three steps have failed."""
    here, jacobian, damping, n_failed, n_stuck = residuals(u), None, 1e-2, 0, 0
    while n_stuck < 3:
        if jacobian is None or n_failed == 3:
            steps = np.where(u + DIFFERENCE > 1.0, -DIFFERENCE, DIFFERENCE)
            jacobian = np.stack(
                [(residuals(u + step) - here) / step.sum() for step in np.diag(steps)], axis=1
            )
            n_failed, n_stuck = 0, n_stuck + 1
        trial = np.clip(u + _step(jacobian, here, u, damping), 0.0, 1.0)
        moved = trial - u
        if float(np.abs(moved).max()) < 1e-9:
            return
        there = residuals(trial)
        jacobian = jacobian + np.outer(there - here - jacobian @ moved, moved) / (moved @ moved)
        gain = here @ here - there @ there
        if gain > 0.0:
            n_stuck = 0 if gain > 1e-5 * (here @ here) else n_stuck
            u, here, damping, n_failed = trial, there, max(damping / 4.0, 1e-8), 0
        else:
            damping, n_failed = min(damping * 4.0, 1e8), n_failed + 1


def _step(jacobian: FloatArray, residuals: FloatArray, u: FloatArray, damping: float) -> FloatArray:
    """Return the damped Gauss-Newton step; coordinates that leave the cube stop at its face. Shape (p,)."""
    step, free = np.zeros_like(u), np.ones(u.size, dtype=np.bool_)
    while free.any():
        part = jacobian[:, free]
        normal = part.T @ part
        ridge = 1e-9 * np.trace(normal) + 1e-300
        normal += damping * np.diag(np.diag(normal)) + ridge * np.eye(len(normal))
        step[free] = -np.linalg.solve(normal, part.T @ (residuals + jacobian[:, ~free] @ step[~free]))
        beyond = free & ((u + step < 0.0) | (u + step > 1.0))
        if not beyond.any():
            break
        step[beyond] = np.clip(u + step, 0.0, 1.0)[beyond] - u[beyond]
        free &= ~beyond
    return step
