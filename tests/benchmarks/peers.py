"""Peers of the adaptive method, each from no initial guess, all counted by our own counter."""

from collections.abc import Callable

import numpy as np

from simulation.arrays import FloatArray
from simulation.counting import BudgetExceeded
from studies.calibration import CalibrationProblem, History, LeastSquaresTRF
from studies.calibration.adaptive import Adaptive
from studies.calibration.adaptive_search import latin_hypercube
from studies.calibration.recorder import Recorder

Method = Callable[[CalibrationProblem, int, int, float], History]
"""Problem, seed, most calls and target error to the history of one run."""

N_SCREENED = 10
DIFFERENCE = 1e-5


class _ReachedError(Exception):
    """The target is reached; nothing more needs to be simulated."""


def adaptive(**settings: int | float) -> Method:
    """Return the adaptive method with other settings than its own."""

    def run(problem: CalibrationProblem, seed: int, max_calls: int, target: float) -> History:
        chosen = Adaptive(ftol=0.0, max_calls=max_calls, target_mse=target, **settings)  # type: ignore[arg-type]
        return chosen.minimize(problem, seed=seed).history

    return run


def trf(problem: CalibrationProblem, seed: int, max_calls: int, target: float) -> History:
    """LS-TRF at its best (signed residuals, logarithmic coordinates) from one random start."""
    del target
    u0 = np.random.default_rng(seed).random(problem.space.n_parameters)
    return LeastSquaresTRF(ftol=1e-9, max_calls=max_calls).minimize(problem, u0).history


def broyden(problem: CalibrationProblem, seed: int, max_calls: int, target: float) -> History:
    """Levenberg-Marquardt with Broyden's updates, from the best of ten Latin hypercube points."""
    return _from_screened(problem, seed, max_calls, target, _levenberg_marquardt)


def dfols(problem: CalibrationProblem, seed: int, max_calls: int, target: float) -> History:
    """DFO-LS from the best of ten Latin hypercube points (doi 10.1145/3338517)."""
    import dfols as peer

    def search(residuals: Callable[[FloatArray], FloatArray], u0: FloatArray) -> None:
        bounds = (np.zeros(u0.size), np.ones(u0.size))
        # It wants its first radius inside the box on both sides of the start.
        start = np.clip(u0, 0.1, 0.9)
        peer.solve(
            residuals, start, bounds=bounds, rhobeg=0.1, rhoend=1e-6, maxfun=max_calls, do_logging=False
        )

    return _from_screened(problem, seed, max_calls, target, search)


Search = Callable[[Callable[[FloatArray], FloatArray], FloatArray], None]


def _from_screened(
    problem: CalibrationProblem, seed: int, max_calls: int, target: float, search: Search
) -> History:
    recorder = Recorder(problem, phase="peer", max_calls=max_calls)

    def residuals(u: FloatArray) -> FloatArray:
        answer = recorder.evaluate(u)
        if recorder.best_mse <= target:
            raise _ReachedError
        return answer.residuals[0]

    try:
        for u in latin_hypercube(N_SCREENED, problem.space.n_parameters, np.random.default_rng(seed)):
            residuals(u)
        assert recorder.best is not None
        search(residuals, recorder.best.u[0])
    except (BudgetExceeded, _ReachedError):
        pass
    return recorder.history


def _levenberg_marquardt(residuals: Callable[[FloatArray], FloatArray], u: FloatArray) -> None:
    """Search until the caller's budget or target ends it; differences only when three steps have failed."""
    here, jacobian, damping, n_failed = residuals(u), None, 1e-2, 0
    while True:
        if jacobian is None or n_failed == 3:
            steps = np.where(u + DIFFERENCE > 1.0, -DIFFERENCE, DIFFERENCE)
            jacobian = np.stack(
                [(residuals(u + step) - here) / step.sum() for step in np.diag(steps)], axis=1
            )
            n_failed = 0
        trial = np.clip(u + _step(jacobian, here, u, damping), 0.0, 1.0)
        moved = trial - u
        if not moved.any():
            return
        there = residuals(trial)
        jacobian = jacobian + np.outer(there - here - jacobian @ moved, moved) / (moved @ moved)
        if there @ there < here @ here:
            u, here, damping, n_failed = trial, there, max(damping / 4.0, 1e-8), 0
        else:
            damping, n_failed = min(damping * 4.0, 1e8), n_failed + 1


def _step(jacobian: FloatArray, residuals: FloatArray, u: FloatArray, damping: float) -> FloatArray:
    """Return the damped Gauss-Newton step; coordinates that leave the cube stop at its face. Shape (p,)."""
    step, free = np.zeros_like(u), np.ones(u.size, dtype=np.bool_)
    while free.any():
        part = jacobian[:, free]
        normal = part.T @ part
        normal += damping * np.diag(np.diag(normal)) + 1e-9 * np.trace(normal) * np.eye(len(normal))
        step[free] = -np.linalg.solve(normal, part.T @ (residuals + jacobian[:, ~free] @ step[~free]))
        beyond = free & ((u + step < 0.0) | (u + step > 1.0))
        if not beyond.any():
            break
        step[beyond] = np.clip(u + step, 0.0, 1.0)[beyond] - u[beyond]
        free &= ~beyond
    return step
