"""Walks downhill from several points of the unit cube at once, for residuals that cost next to nothing."""

import math
from collections.abc import Callable

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.prior import Prior

# Damped steps from all starts together. By hand.
N_STEPS, SHIFT, MOST_STEP = 40, 1e-4, 0.3
# Damping relative to the curvature, as is usual for Levenberg-Marquardt; by hand.
DAMPING_AT_FIRST, EASIER, HARDER, HOPELESS = 1e-2, 0.2, 4.0, 1e8
# Relative gain that ends a walk.
LEAST_GAIN = 1e-5
# Best rows and last ends that walks begin at, beside the best of random points: nothing else looks for
# valleys. By hand.
N_BEST_ROWS, N_LAST_ENDS = 2, 2

Residuals = Callable[[FloatArray], FloatArray]
"""Points (n, p) to residuals (n, m), not finite where nothing is known."""


def objectives(prior: Prior | None, u: FloatArray, residuals: FloatArray) -> FloatArray:
    """Return the objectives, infinite where residuals are not finite. Shape (n,). [unit squared].

    Args:
        prior: Of the parameters, None where nothing is known.
        u: Points. Shape (n, p). [1]
        residuals: Those there. Shape (n, m). [unit]
    """
    with np.errstate(all="ignore"):
        mse = np.mean(residuals**2, axis=1)
    if prior is not None:
        mse = mse + prior.penalty(u)
    return np.where(np.isfinite(mse), mse, np.inf)


def jacobians(residuals: Residuals, u: FloatArray, here: FloatArray) -> FloatArray:
    """Return the residuals' slopes at several points, by differences that are asked for together.

    Args:
        residuals: The function.
        u: Points. Shape (k, p). [1]
        here: Residuals there. Shape (k, m). [unit]

    Returns:
        Shape (k, m, p), not finite where the residuals are not. [unit]
    """
    k, p = u.shape
    # Toward the middle, so that no difference leaves the box.
    shift = np.where(u > 0.5, -SHIFT, SHIFT)
    beside = u[:, None] + shift[:, None] * np.eye(p)
    there = residuals(beside.reshape(-1, p)).reshape(k, p, here.shape[1])
    with np.errstate(all="ignore"):
        return ((there - here[:, None]) / shift[..., None]).transpose(0, 2, 1)


def descend_together(
    residuals: Residuals, prior: Prior | None, starts: FloatArray, is_held: BoolArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Walk downhill from several points of the unit cube at once, by damped Gauss-Newton steps.

    The residuals of all points that are needed are asked for together, differences included.

    Args:
        residuals: The function.
        prior: Of the parameters, None where nothing is known.
        starts: Shape (k, p). [1]
        is_held: Which coordinates stay as they are in which walk, None for none. Shape (k, p).

    Returns:
        Where the walks end, shape (k, p), and the objectives there, shape (k,). [unit squared]
    """
    u = np.clip(starts, 0.0, 1.0)
    k, p = u.shape
    is_free = np.ones((k, p), dtype=np.bool_) if is_held is None else ~is_held
    here = residuals(u)
    values = objectives(prior, u, here)
    damping = np.full(k, DAMPING_AT_FIRST)
    is_open = np.isfinite(values)
    jacobian = np.zeros((k, here.shape[1], p))
    is_stale = is_open.copy()
    for _ in range(N_STEPS):
        walks = np.flatnonzero(is_open)
        if not walks.size:
            break
        stale = np.flatnonzero(is_open & is_stale)
        # A refused step changes the damping alone: the Jacobian of its point, the costly part, is used again.
        if stale.size:
            jacobian[stale] = jacobians(residuals, u[stale], here[stale])
            is_stale[stale] = False
            # Where points beside cannot be solved, the walk ends.
            is_open[stale] = np.isfinite(jacobian[stale]).all(axis=(1, 2))
            walks = np.flatnonzero(is_open)
            if not walks.size:
                break
        trial = u[walks].copy()
        for row, one in enumerate(walks):
            trial[row] = _step(u[one], here[one], jacobian[one], damping[one], prior, is_free[one])
        answers = residuals(trial)
        found = objectives(prior, trial, answers)
        is_lower = found < values[walks]
        gain = np.where(is_lower, values[walks] - found, 0.0)
        lower, higher = walks[is_lower], walks[~is_lower]
        is_open[lower] = gain[is_lower] > LEAST_GAIN * values[lower]
        u[lower], here[lower], values[lower] = trial[is_lower], answers[is_lower], found[is_lower]
        is_stale[lower] = True
        damping[lower] *= EASIER
        damping[higher] *= HARDER
        is_open[higher] = damping[higher] < HOPELESS
    return u, values


class Descents:
    """Walks downhill all over the unit cube, again and again while rows change the residuals."""

    def __init__(self, prior: Prior | None, n_parameters: int, n_random: int) -> None:
        """Begin without a walk.

        Args:
            prior: Of the parameters, None where nothing is known.
            n_parameters: Parameters p.
            n_random: How many of the points that are looked at are walked downhill.
        """
        self._prior, self._n_random = prior, n_random
        self._ends = np.empty((0, n_parameters))

    def lowest(
        self,
        residuals: Residuals,
        looks: FloatArray,
        rows: FloatArray,
        walked: Residuals | None = None,
        *,
        share: float = 1.0,
    ) -> tuple[FloatArray, FloatArray]:
        """Walk downhill from the best rows, where the last walks ended, and from the best looks.

        Args:
            residuals: The function.
            looks: Points that are compared. Shape (k, p). [1]
            rows: Rows so far, the best first. Shape (n, p). [1]
            walked: What is walked on in its place, None for the function itself.
            share: How many of the usual looks and walks there are, where each takes long; at least one walk
                of each kind. [1]

        Returns:
            Where the walks end, the lowest first, shape (w, p), and the objectives there, shape (w,). [unit
            squared]
        """
        looks = looks[: math.ceil(share * len(looks))]
        n_rows, n_ends, n_random = (math.ceil(share * n) for n in (N_BEST_ROWS, N_LAST_ENDS, self._n_random))
        best = np.argsort(objectives(self._prior, looks, residuals(looks)), kind="stable")[:n_random]
        starts = np.concatenate([rows[:n_rows], self._ends[:n_ends], looks[best]])
        ends, values = descend_together(walked or residuals, self._prior, starts)
        order = np.argsort(values, kind="stable")
        # One more row moves the optimum little: the next walks begin where these have ended.
        self._ends = ends[order[:N_LAST_ENDS]]
        return ends[order], values[order]


# A step that overflows leads nowhere.
@np.errstate(all="ignore")
def _step(
    u: FloatArray,
    residuals: FloatArray,
    jacobian: FloatArray,
    damping: float,
    prior: Prior | None,
    is_free: BoolArray,
) -> FloatArray:
    """Return where a damped Gauss-Newton step leads; what it pushes out of the box stays at its face."""
    gradient = 2.0 * (jacobian.T @ residuals) / residuals.size
    hessian = 2.0 * (jacobian.T @ jacobian) / residuals.size
    if prior is not None:
        known = prior.expand(u)
        gradient, hessian = gradient + known.gradient, hessian + known.hessian
    # What the slope pushes against a face stays there (projected Newton method, see box_newton.py).
    free = np.flatnonzero(is_free & ~(((u <= 0.0) & (gradient > 0.0)) | ((u >= 1.0) & (gradient < 0.0))))
    trial = u.copy()
    if free.size and np.isfinite(hessian).all():
        block = hessian[np.ix_(free, free)]
        # Marquardt's damping by the diagonal; the trace's
        # small share holds directions that have no curvature.
        ridge = damping * np.diag(block) + 1e-12 * np.trace(block) + np.finfo(float).tiny
        step = np.linalg.solve(block + np.diag(ridge), -gradient[free])
        # Residuals are linear nearby alone: without a limit, a first step may cross the whole box.
        trial[free] = np.clip(u[free] + np.clip(step, -MOST_STEP, MOST_STEP), 0.0, 1.0)
    return trial
