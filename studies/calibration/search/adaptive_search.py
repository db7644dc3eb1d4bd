"""The story of an adaptive calibration: which move comes next, and when the search ends."""

import math
from collections.abc import Callable
from functools import partial

import numpy as np

from studies.calibration.proposer import Proposer
from studies.calibration.search import ending, moves
from studies.calibration.search.ending import Ending
from studies.calibration.search.first_design import first_points
from studies.calibration.search.search_phase import STAGNANT_ROUNDS
from studies.calibration.search.search_state import SearchState

# Points that are simulated where equations may act that no simulation has shown
# (docs/notes/state-equations.md, Ranges that no row has shown).
N_PROBES = 4
# Share of the variance below which the window is doubled once nothing more is gained in it
# (docs/notes/adaptive-search.md, Truncated windows).
NEARLY_EXPLAINED = 0.1

Move = Callable[[SearchState], None]


def run(state: SearchState) -> Ending:
    """Ask points until target, tolerance or restarts in vain; return why it ended.

    Raises:
        BudgetExceeded: The budget is spent.
    """
    rows = state.rows
    n_design = rows.n_first - rows.n_known
    if n_design and state.equations.believed is None:
        moves.ask_first(state, first_points(n_design, rows.u.shape[1], state.rng))
    while True:
        try:
            move = next_move(state)
            if isinstance(move, Ending):
                return move
            move(state)
        # Simulations that no surrogate can be fitted to: others may show more.
        except np.linalg.LinAlgError:
            moves.ask_anywhere(state)


def next_move(state: SearchState) -> Move | Ending:
    """Return what is done next, or why the search ends."""
    rows, equations = state.rows, state.equations
    target = state.settings.target_mse
    if target is not None and state.recorder.best_mse <= target:
        return Ending("the target is reached", converged=True)
    if target is None and equations.is_outdone and not state.is_too_large:
        return ending.outdone(equations)
    ode = equations.believed
    # What equations have left of the first design is asked once they are not believed.
    if len(state.unasked) and ode is None:
        return moves.ask_rest
    n_good = rows.good.sum()
    # A process needs two simulations that succeeded.
    if n_good < 2 and ode is None:
        return moves.ask_anywhere
    go_on = moves.search_round if n_good > 1 or ode is None else partial(moves.ask_by_equations, ode=ode)
    if not n_good:
        return go_on
    while state.leaders:
        state.recorder.think_of(state.leaders[0].NAME)
        points = state.leaders[0].propose(state.settings.n_parallel)
        if points is not None:
            return partial(SearchState.ask, u=points)
        del state.leaders[0]
    moves.adapt_window(state)
    if state.fits_exactly:
        return moves.compare_beside if _needs_slopes(state) else ending.exact(state)
    if not _phase_is_over(state):
        return go_on
    is_narrow = state.is_at_best and not rows.window.is_whole
    if is_narrow and (state.confirmation.n_restarts > 0 or rows.unexplained <= NEARLY_EXPLAINED):
        return moves.double_window
    if ode is not None:
        return (_beyond_rows(state, ode) or ending.by_equations(state)) if state.is_at_best else moves.turn
    if state.has_settled:
        if not state.confirmation.is_tested:
            return moves.test
        if state.may_end:
            known, is_too_large = state.confirmation, state.is_too_large
            return ending.after_tests(known, switches=rows.switches, is_too_large=is_too_large)
    return moves.turn


def _needs_slopes(state: SearchState) -> bool:
    """Return whether the model has to be asked what it does beside an exact fit, and may be asked.

    A surrogate knows a ridge from points that lie along it, and an exact fit comes before there are any.
    """
    is_affordable = state.n_left >= 2 * state.rows.u.shape[1]
    return state.equations.believed is None and state.differences is None and is_affordable


def _phase_is_over(state: SearchState) -> bool:
    """Return whether the search phase has converged or gains too little."""
    if state.equations.believed is not None:
        return state.phase.n_idle >= STAGNANT_ROUNDS
    return state.phase.gains_little(
        state.rows.best(state.phase.first).outlying,
        is_at_best=state.is_at_best,
        is_whole=state.rows.window.is_whole,
    )


def _beyond_rows(state: SearchState, ode: Proposer) -> Move | None:
    """Return what may show that the model does more than equations know, None for nothing."""
    n = math.ceil(N_PROBES / state.settings.n_parallel) * state.settings.n_parallel
    is_open = state.n_left >= n and not state.equations.has_probed
    # Two signs of a part of the model that no simulation has shown (docs/notes/state-equations.md, Ranges
    # that no row has shown): an error too large for the sensor, and parameters in no equation.
    if is_open and (state.is_too_large or ode.left_out.any()):
        return partial(moves.probe, ode=ode, n=n)
    if state.is_too_large and len(state.unasked):
        state.phase.n_idle = 0
        return moves.ask_rest
    return None
