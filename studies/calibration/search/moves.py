"""The moves of a search: what it simulates next, and how its phase, window and tests change."""

import math

import numpy as np

from simulation.arrays import FloatArray
from studies.calibration.box_newton import Expansion
from studies.calibration.differences import difference_rows, difference_slopes
from studies.calibration.proposer import Proposer
from studies.calibration.search.confirmation import least_unlikely
from studies.calibration.search.expected_objective import CAUTION, ExpectedObjective, is_surprised
from studies.calibration.search.proposals import N_DESCENTS, Surroundings, favourites, informative
from studies.calibration.search.restart import farther_along, least_excluded
from studies.calibration.search.rows import Incumbent
from studies.calibration.search.search_phase import STAGNANT_ROUNDS, SearchPhase
from studies.calibration.search.search_state import SearchState
from studies.calibration.search.trust_region import TrustRegion
from studies.calibration.state_equations.coefficient import LEAST_TO_LEARN
from studies.calibration.state_equations.learned_ode import enough_for_equations

# Step of the differences beside an exact fit, as in studies/calibration/uncertainty/assess.py.
STEP_BESIDE = 0.01
# Share of an output's measured variance above which the window is truncated (docs/notes/adaptive-search.md,
# Truncated windows).
UNEXPLAINED = 0.25
# Share below which the window is doubled (the same section).
WINDOW_EXPLAINED = 0.02
# A search whose best error falls by this factor within so many rounds needs no truncated window (the same).
FALLING, FALLING_ROUNDS = 0.5, 3
# Distance to the best point at which a restarted phase has come back. By hand.
CAME_BACK = 0.1


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
    """Ask two points beside the best one along every parameter, for the slopes there."""
    rows = state.rows
    n, best = rows.n, rows.best()
    state.ask(difference_rows(best.u, STEP_BESIDE)[1:])
    places = [best.row, *range(n, rows.n)]
    state.differences = difference_slopes(rows.u[places], rows.residuals[places]).T


def probe(state: SearchState, ode: Proposer, n: int) -> None:
    """Ask n points where states go beyond what simulations have shown, as where a valve closes."""
    state.equations.has_probed = True
    state.phase.n_idle = 0
    state.ask(ode.unseen(state.rows.best().u, n, state.rng))


def test(state: SearchState) -> None:
    """Ask where a lower error is least unlikely within all bounds; go on from what is better."""
    rows = state.rows
    best, n = rows.best(), rows.n
    state.recorder.think_of("functions that may be lower at other points")
    objective = state.surrogates.expected(rows, best.objective)
    places, gains = least_unlikely(objective, best, (rows.u, rows.good), state.settings.n_parallel, state.rng)
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
    is_open = window.was_needed is None and rows.n >= rows.n_first + n_design
    if is_open and not rows.lowest() < FALLING * rows.objective[:-n_last].min():
        window.was_needed = rows.unexplained > UNEXPLAINED
        if window.was_needed:
            window.shorten(to_features=rows.switches)
            state.begin_again()
    while not window.is_whole and rows.unexplained <= WINDOW_EXPLAINED:
        double_window(state)


def double_window(state: SearchState) -> None:
    """Double the window and go on from the simulation that is best then."""
    state.rows.window.double()
    state.begin_again()


def ask_by_equations(state: SearchState, ode: Proposer) -> None:
    """Make a round by equations that are believed before there are two simulations, as a process needs."""
    rows = state.rows
    point, expected = ode.propose(rows.objective, rows.u, state.rng)
    rest = rows.best().rest if rows.n else np.inf
    promise = rows.lowest() - expected.value
    if promise <= state.least_gain * rest < np.inf:
        state.stay(max(promise / rest, 0.0) if rest > 0.0 else 0.0)
        return
    state.ask(point[None])
    state.phase.lowest.append(state.phase_best)


def search_round(state: SearchState) -> None:
    """Make one round of a search phase by the processes, or by state equations that are believed."""
    rows, phase, equations = state.rows, state.phase, state.equations
    if phase.first == rows.n:
        _restart(state)
        return
    # A phase whose simulations have all failed goes on from the best one.
    best = rows.best(phase.first if np.isfinite(state.phase_best) else 0)
    objective = state.surrogates.expected(rows, best.objective)
    points, expected = _proposed(state, objective, best)
    promise, rest = best.objective - expected.value, best.rest
    share = promise / rest if rest > 0.0 else 0.0
    is_exact = equations.is_sure and promise <= state.least_gain * rest
    has_settled = state.confirmation.n_tested and state.region.is_whole and equations.believed is None
    if is_exact or (has_settled and state.is_at_best and promise <= state.ftol * rest):
        # Exact equations only search for their optimum again; and nothing
        # that was asked since the first test has changed what is expected here.
        state.stay(max(share, 0.0) if is_exact else share)
        phase.n_stagnant += not is_exact
        return
    step = points[0] - best.u
    if phase.is_far and not state.is_at_best:
        home = rows.best()
        has_come_back = np.abs(points[0] - home.u).max() < CAME_BACK
        # Near another local minimum, no call is spent where that is excluded already.
        is_end = has_come_back or not state.region.is_at_edge(step)
        if is_end and objective.excludes(points[0], expected, home):
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
        predicted = objective.expand(points[0], CAUTION).value
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


def _restart(state: SearchState) -> None:
    """Begin a search phase away from the best point, at one point for each parallel simulation."""
    state.recorder.think_of("another valley")
    best = state.rows.best()
    expand = state.surrogates.expected(state.rows, best.objective).expand
    shape = (state.settings.n_parallel, best.u.size)
    if state.phase.is_far:
        state.ask(least_excluded(expand, best, shape, state.rng))
    else:
        state.ask(farther_along(expand, shape, state.rng))
    state.phase.lowest.append(state.phase_best)


def _proposed(
    state: SearchState, objective: ExpectedObjective, best: Incumbent
) -> tuple[FloatArray, Expansion]:
    """Return the points to simulate next, the favourite first, and what is expected of it."""
    rows, rng, q = state.rows, state.rng, state.settings.n_parallel
    # Near another local minimum, descents from random starts would lead back to the best of all.
    n_descents = 1 if state.phase.is_far and not state.is_at_best else N_DESCENTS
    around = Surroundings(objective, best.u, state.region.radius, rows.u, n_descents)
    if (ode := state.equations.believed) is not None:
        point, favourite = ode.propose(rows.objective, rows.u, rng)
        points = point[None]
    else:
        points, favourite = favourites(around, (q + 1) // 2, rng)
    if len(points) < q:
        points = np.concatenate([points, informative(around, points, favourite, q - len(points), rng)])
    return points, favourite
