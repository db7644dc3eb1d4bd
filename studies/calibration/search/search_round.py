"""One round of a search phase: where it begins, around its best point, or by state equations alone."""

from functools import partial

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.processes.groups import ProcessGroups
from studies.calibration.search.expected_objective import (
    CAUTION,
    expected_objective,
    is_surely_no_better,
    is_surprised,
)
from studies.calibration.search.moves import turn
from studies.calibration.search.proposals import N_DESCENTS, Surroundings, favourites, informative
from studies.calibration.search.restart import farther_along, least_excluded
from studies.calibration.search.rows import Incumbent
from studies.calibration.search.search_phase import SearchPhase
from studies.calibration.search.search_state import SearchState
from studies.calibration.state_equations.learned_ode import LearnedODE

# Distance to the best point at which a restarted phase has come back. By hand.
CAME_BACK = 0.1


def ask_by_equations(state: SearchState, ode: LearnedODE) -> None:
    """Make a round by equations that are believed before there are two simulations, as a process needs."""
    rows = state.rows
    point, expected = ode.propose(rows.objective, rows.u, state.rng)
    rest = rows.best().rest if rows.n else np.inf
    promise = rows.lowest() - expected.value
    if promise <= state.least_gain * rest < np.inf:
        state.expected_gain = max(promise / rest, 0.0) if rest > 0.0 else 0.0
        state.phase.n_idle += 1
        state.equations.forget_proposal()
        return
    state.ask(point[None])
    state.phase.lowest.append(state.phase_best)


def search_round(state: SearchState) -> None:
    """Make one round of a search phase by the processes, or by state equations that are believed."""
    rows, phase, surrogates = state.rows, state.phase, state.surrogates
    equations, confirmation = state.equations, state.confirmation
    process = surrogates.fit(rows)
    if phase.first == rows.n:
        _restart(state, process)
        return
    # A phase whose simulations have all failed goes on from the best one.
    best = rows.best(phase.first if np.isfinite(state.phase_best) else 0)
    surrogates.weigh_failures(rows, best.objective)
    points, expected = _proposed(state, process, best)
    promise, rest = best.objective - expected.value, best.rest
    share = promise / rest if rest > 0.0 else 0.0
    if equations.is_sure and promise <= state.least_gain * rest:
        # The equations are exact, so that rows add nothing: the optimum is only searched for again.
        state.expected_gain = max(share, 0.0)
        phase.n_idle += 1
        equations.forget_proposal()
        return
    is_settled = confirmation.n_tested and state.region.is_whole and equations.believed is None
    if is_settled and state.is_at_best and promise <= state.ftol * rest:
        # Nothing that was asked since the first test has changed what is expected here.
        state.expected_gain = share
        phase.n_idle += 1
        phase.n_stagnant += 1
        return
    step = points[0] - best.u
    if phase.is_far and not state.is_at_best:
        home = rows.best()
        has_come_back = np.abs(points[0] - home.u).max() < CAME_BACK
        # Near another local minimum, no call is spent where that is excluded already.
        is_end = has_come_back or not state.region.is_at_edge(step)
        if is_end and is_surely_no_better(process, points[0], expected, home):
            turn(state)
            return
    predicted, n = equations.predicted, rows.n
    state.ask(points)
    # The end of the budget may have cut off all points but the first ones.
    objectives = rows.objective[n:]
    gain = max(best.objective - state.phase_best, 0.0)
    state.region = state.region.after(step, objectives, gain, promise)
    state.expected_gain = share
    if predicted is None:
        predicted = expected_objective(process, surrogates.penalty, points[0], CAUTION).value
    # A surrogate that errs at its favourite point ends no
    # search (docs/notes/adaptive-search.md, Truncated windows).
    first = float(objectives[0])
    is_believed = equations.believed is not None
    if is_believed and equations.judge_proposal(gain, abs(first - predicted), rest):
        # What is left to gain is less than what the equations err by, unless these err at other points.
        state.phase = SearchPhase()
    # A round is in vain where neither found nor expected gains are left.
    hope = max(gain, promise)
    values = (first, predicted, expected.value, best.objective)
    if is_surprised(*(value - best.outlying for value in values)):
        hope = np.inf
    phase.note(hope, rest, state.ftol, is_whole=rows.window.is_whole)
    phase.lowest.append(state.phase_best)


def _restart(state: SearchState, process: ProcessGroups) -> None:
    """Begin a search phase away from the best point, at one point for each parallel simulation."""
    rows, surrogates = state.rows, state.surrogates
    state.recorder.think_of("another valley")
    best = rows.best()
    surrogates.weigh_failures(rows, best.objective)
    expand = partial(expected_objective, process, surrogates.penalty)
    shape = (state.settings.n_parallel, best.u.size)
    if state.phase.is_far:
        state.ask(least_excluded(expand, best, shape, state.rng))
    else:
        state.ask(farther_along(expand, shape, state.rng))
    state.phase.lowest.append(state.phase_best)


def _proposed(state: SearchState, process: ProcessGroups, best: Incumbent) -> tuple[FloatArray, Expansion]:
    """Return the points to simulate next, the favourite first, and what is expected of it."""
    rows, rng, q = state.rows, state.rng, state.settings.n_parallel
    # Near another local minimum, descents from random starts would lead back to the best of all.
    n_descents = 1 if state.phase.is_far and not state.is_at_best else N_DESCENTS
    around = Surroundings(process, state.surrogates.penalty, best.u, state.region.radius, rows.u, n_descents)
    if (ode := state.equations.believed) is not None:
        point, favourite = ode.propose(rows.objective, rows.u, rng)
        points = point[None]
    else:
        points, favourite = favourites(around, (q + 1) // 2, rng)
    if len(points) < q:
        points = np.concatenate([points, informative(around, points, favourite, q - len(points), rng)])
    return points, favourite
