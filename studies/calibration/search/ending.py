"""How a search ended, in words, and what may be left to gain."""

import math
from dataclasses import dataclass

import numpy as np

from studies.calibration.search.confirmation import CONFIRMED, PROMISED, Confirmation
from studies.calibration.search.equations import Equations
from studies.calibration.search.restart import WANTED
from studies.calibration.search.search_phase import STALL_ROUNDS
from studies.calibration.search.search_state import SearchState


@dataclass(frozen=True)
class Ending:
    """Why a search ended.

    Attributes:
        reason: In words.
        converged: Whether the target is reached, or nothing more is expected and tests of that found nothing.
    """

    reason: str
    converged: bool


def exact(state: SearchState) -> Ending:
    """Return the end of a search that has nothing left to gain."""
    sensor = float(state.recorder.problem.measurement.uncertainty[0])
    within = math.sqrt(state.recorder.best_mse) / sensor
    reason = f"the best simulation fits within {within:.2g} of the sensor's uncertainty (RMS)"
    return Ending(reason, converged=within <= 1.0)


def by_equations(state: SearchState) -> Ending:
    """Return the end of a search by state equations that expects nothing more."""
    target, error = state.settings.target_mse, state.equations.error_in_words
    little = f"a gain of less than {state.least_gain:g} of the error"
    missed = "" if target is None else f"; the target of {target:g} is missed"
    nowhere = f", and nowhere {WANTED:g} times the error" if state.is_too_large else ""
    beyond = f", but {error}" if error else ""
    reason = f"the state equations expect {little}{nowhere}{missed}{beyond}"
    return Ending(reason, converged=(target is None or state.equations.is_sure) and not error)


def outdone(equations: Equations) -> Ending:
    """Return the end of a search whose equations know the optimum as well as they can."""
    n, error = len(equations.vain), max(equations.vain)
    return Ending(
        f"the last {n} simulations at the optimum of the state equations gained less than the equations "
        f"err by ({error:.2g} of the error): at most {PROMISED:g} of it could still be gained",
        converged=True,
    )


def after_tests(known: Confirmation, *, switches: bool, is_too_large: bool = False) -> Ending:
    """Return the end of a search that has made all tests and restarts.

    Args:
        known: The tests and restarts.
        switches: Whether the model switches at times that depend on its parameters: functions that are drawn
            are smooth, and cannot promise what another number of switchings would gain.
        is_too_large: Whether the error is above the misfit threshold.
    """
    tests = f"{_counted(known.n_tested, 'round')} of tests where more is least unlikely"
    if known.n_restarts:
        tests += f" and {_counted(known.n_restarts, 'restart')}"
    in_vain = f"{tests} since the last gain of {CONFIRMED:g} found no lower error"
    if is_too_large:
        return Ending(f"{in_vain}, though it is more than the sensor explains", converged=False)
    # Four of six thermostats had said "converged" and were wrong (docs/calibration.md).
    if switches:
        return Ending(
            f"{in_vain}; the model switches at times that depend on its parameters, so that another "
            "minimum is not excluded",
            converged=False,
        )
    if known.is_promising:
        return Ending(f"{in_vain}, and no more is expected around the best point", converged=False)
    return Ending(
        f"what is known of the model promises no gain above {PROMISED:g} of the error anywhere in "
        f"the box, and {tests} gained no more",
        converged=True,
    )


def left(state: SearchState) -> str:
    """Say what may be left to gain where a search stopped, and what the next round would try."""
    rows, error = state.rows, state.equations.error_in_words
    if not np.isfinite(state.recorder.best_mse):
        return ""
    if error:
        return f"the state equations {error}; --no-state-equations searches without them"
    if len(state.unasked) or rows.n < rows.n_first:
        return "the first design is not finished, and the next round would go on with it"
    if state.is_too_large and state.is_tried:
        return "a deeper valley may be left, or the model lacks something; another seed begins anew"
    if not rows.window.is_whole:
        return "so far only the first part of the trajectories is fitted; the next round would go on with it"
    if state.is_at_best and not state.region.is_whole:
        return "simulations around the best point fail; the next round would begin away from it"
    if state.confirmation.n_tested or state.has_settled:
        return still_owed(state.confirmation, state.settings.ftol)
    n = min(STALL_ROUNDS * state.settings.n_parallel, rows.n - 1)
    before = float(rows.objective[: rows.n - n].min())
    gained = 1.0 - rows.lowest() / before if np.isfinite(before) and before > 0.0 else 1.0
    expected = state.expected_gain
    hope = f"; the surrogate expected {expected:.2g} of the last round" if np.isfinite(expected) else ""
    return (
        f"the last {_counted(n, 'simulation')} gained {gained:.2g} of the error{hope}; the next round would "
        "go on from the best point"
    )


def still_owed(known: Confirmation, ftol: float) -> str:
    """Say which tests and restarts are left to a search that expects less than `ftol` and has to stop."""
    if known.is_tested and known.has_looked:
        return (
            f"a gain of up to {known.promised:.2g} of the error is not excluded in the box; "
            "another seed begins anew"
        )
    owed = known.n_owed
    tests = f"{min(known.n_tested, owed + 1)} of {owed + 1} rounds of tests"
    restarts = f"{min(known.n_restarts, owed)} of {owed} restarts"
    return (
        f"around the best point a gain of less than {ftol:g} of the error is expected, which {tests} and "
        f"{restarts} have confirmed; the next round would go on with these"
    )


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
