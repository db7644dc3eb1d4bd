"""The moves of a search: what it simulates next, and how its phase, window and tests change.

A round of a search phase, the commonest move, is in search_round.py.
"""

import math

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.differences import difference_rows, difference_slopes
from studies.calibration.search.confirmation import least_unlikely
from studies.calibration.search.search_phase import STAGNANT_ROUNDS, SearchPhase
from studies.calibration.search.search_state import SearchState
from studies.calibration.search.trust_region import TrustRegion
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN
from studies.calibration.state_equations.learned_ode import LearnedODE, enough_for_equations

# Step of the differences beside an exact fit, as in studies/calibration/uncertainty/assess.py.
BESIDE = 0.01
# Share of an output's measured variance above which the window is truncated (docs/notes/adaptive-search.md,
# Truncated windows).
UNEXPLAINED = 0.25
# Share below which the window is doubled (the same section).
EXPLAINED = 0.02
# A search whose best error falls by this factor within so many rounds needs no truncated window (the same).
FALLING, FALLING_ROUNDS = 0.5, 3


def ask_first(state: SearchState, design: FloatArray) -> None:
    """Ask a first design, round by round where state equations may take less of it."""
    n_asked, q = 0, state.settings.n_parallel
    equations = state.equations
    if (ode := equations.ode) is not None:
        # At most as many rows' worth as points: the budget still holds a whole row afterwards.
        equations.n_alone = ode.learn_alone(design[: state.settings.max_calls - 1])
        if equations.n_alone:
            state.recorder.pay(equations.n_alone)
        if equations.believed is None:
            _forget_alone(state)
        n_acting = state.recorder.problem.n_acting
        n_enough = min(math.ceil(enough_for_equations(n_acting) / q) * q, len(design))
        # Whole rounds: one with idle workers takes as long.
        n_next = math.ceil(LEAST_TO_LEARN / q) * q
        while n_asked < n_enough and not ode.is_sure:
            n_next = min(n_next, n_enough - n_asked)
            state.ask(design[n_asked : n_asked + n_next])
            n_asked, n_next = n_asked + n_next, q
    state.unasked = design[n_asked:]


def ask_rest(state: SearchState) -> None:
    """Ask what state equations have left of the first design."""
    _forget_alone(state)
    state.unasked, rest = state.unasked[:0], state.unasked
    state.ask(rest)


def _forget_alone(state: SearchState) -> None:
    """Do not count what was simulated in single experiments: the whole rows that follow hold it."""
    equations = state.equations
    if equations.ode is not None and equations.n_alone:
        state.recorder.pay(-equations.n_alone)
        equations.n_alone = equations.ode.n_alone = 0


def ask_anywhere(state: SearchState) -> None:
    """Ask a round of random points."""
    state.ask(state.rng.random((state.settings.n_parallel, state.rows.u.shape[1])))


def compare_beside(state: SearchState) -> None:
    """Ask points on both sides of the best one along every parameter, for the slopes there."""
    rows = state.rows
    n, best = rows.n, rows.best()
    # So far inside that no side is cut: a one-sided difference shows a slope along a bent ridge.
    state.ask(difference_rows(np.clip(best.u, BESIDE, 1.0 - BESIDE), BESIDE)[1:])
    places = [best.row, *range(n, rows.n)]
    state.differences = difference_slopes(rows.u[places], rows.residuals[places]).T


def probe(state: SearchState, ode: LearnedODE, n: int) -> None:
    """Ask n points where states go beyond what simulations have shown, as where a valve closes."""
    state.equations.has_probed = True
    state.phase.n_idle = 0
    state.ask(ode.unseen(state.rows.best().u, n, state.rng))


def test(state: SearchState) -> None:
    """Ask where a lower error is least unlikely within all bounds; go on from what is better."""
    rows, surrogates = state.rows, state.surrogates
    best, n = rows.best(), rows.n
    state.recorder.think_of("functions that may be lower at other points")
    process = surrogates.fit(rows)
    surrogates.weigh_failures(rows, best.objective)
    places, gains = least_unlikely(
        process, surrogates.penalty, best, (rows.u, rows.good), state.settings.n_parallel, state.rng
    )
    state.ask(places)
    if rows.lowest() - best.outlying < (1.0 - state.settings.ftol) * best.rest:
        state.phase = SearchPhase()
        return
    # What fails confirms nothing.
    if rows.good[n:].any():
        state.confirmation.note_test(gains)
    # What was learnt may show a step from the best point.
    state.phase.n_stagnant = STAGNANT_ROUNDS - 1


def turn(state: SearchState) -> None:
    """End a search phase: restart away from the best point, or go back to it."""
    state.equations.forget_proposal()
    if not state.is_at_best:
        state.phase, state.region = SearchPhase(), state.region.widened()
        return
    state.confirmation.n_restarts += 1
    # Where the error still falls, that is followed; from a local minimum the search restarts far away.
    state.phase, state.region = SearchPhase(state.rows.n, state.phase.has_settled), TrustRegion()


def adapt_window(state: SearchState) -> None:
    """Truncate the window, once, of a search that explains too little; double it once it is explained."""
    rows = state.rows
    window = rows.window
    if state.equations.believed is not None:
        # State equations predict the whole trajectory.
        while not window.is_whole:
            double_window(state)
        return
    n_design = state.n_whole_design
    n_last = min(FALLING_ROUNDS * state.settings.n_parallel, n_design)
    if window.was_needed is None and rows.n >= rows.n_first + n_design:
        is_falling = rows.lowest() < FALLING * rows.objective[:-n_last].min()
        if not is_falling:
            window.was_needed = rows.unexplained > UNEXPLAINED
            if window.was_needed:
                window.shorten(to_features=rows.switches)
                state.begin_again()
    while not window.is_whole and rows.unexplained <= EXPLAINED:
        double_window(state)


def double_window(state: SearchState) -> None:
    """Double the window and go on from the simulation that is best then."""
    state.rows.window.double()
    state.begin_again()
