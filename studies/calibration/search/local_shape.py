"""What a search that has ended knows of the error around its best point."""

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.search.rows import Incumbent
from studies.calibration.search.search_state import SearchState

# A parameter whose error at so many values across its range varies by less than this part has no effect. By
# hand.
N_ACROSS, FLAT = 9, 1e-3


def local_shape(state: SearchState) -> tuple[BoolArray, FloatArray | None]:
    """Return on which parameters the error hardly depends, and the residuals' slopes.

    A slope that simulations leave open counts as large as it may be: where it is 0, that has been seen.

    Returns:
        Parameters over all of whose ranges the error around the best point hardly changes, shape (p,). Slopes
        there, in an orthonormal basis of p residuals, None where too little is known of the model. Shape
        (p, p). [first output's unit per range]
    """
    ode, believed = state.equations.ode, state.equations.believed
    best = state.rows.best()
    # Equations that are sure need no process, but where they were given up.
    process = None if believed is not None and believed.is_sure else _last_process(state)
    is_flat = ode.left_out if ode is not None and ode.is_sure else _is_flat(process, best)
    if believed is not None:
        return is_flat, _root(believed.slopes(best.u))
    if state.differences is not None:
        return is_flat, _root(state.differences)
    if state.fits_exactly or process is None:
        return is_flat, None
    # The Hessian is 2 J' J / m, with what the variance adds: its root is J but for a rotation, in p rows.
    hessian = 0.5 * state.rows.residuals.shape[1] * process.expand(best.u, 1.0).hessian
    if not np.isfinite(hessian).all():
        return is_flat, None
    squares, axes = np.linalg.eigh(hessian)
    return is_flat, np.asarray(np.sqrt(np.maximum(squares, 0.0))[:, None] * axes.T)


def _root(slopes: FloatArray) -> FloatArray | None:
    """Return the triangular factor of slopes (m, p): it has their singular values and products in p rows."""
    return np.asarray(np.linalg.qr(slopes, mode="r")) if np.isfinite(slopes).all() else None


def _is_flat(process: ProcessGroups | None, best: Incumbent) -> BoolArray:
    p = best.u.size
    if process is None:
        return np.zeros(p, dtype=np.bool_)
    across = np.tile(best.u, (p, N_ACROSS, 1))
    across[np.arange(p), :, np.arange(p)] = np.linspace(0.0, 1.0, N_ACROSS)
    errors = process.errors(across.reshape(-1, p)).reshape(p, N_ACROSS)
    return np.asarray(np.ptp(errors, axis=1) <= FLAT * best.rest)


def _last_process(state: SearchState) -> ProcessGroups | None:
    """Return the surrogate of all simulations; None where these are a first design or less."""
    rows = state.rows
    is_enough = rows.window.is_whole and rows.n > rows.n_first
    if not is_enough or not 0.0 < rows.lowest() < np.inf or rows.sane.sum() < 2:
        return None
    try:
        return state.surrogates.fit(rows)
    except np.linalg.LinAlgError:
        return None
