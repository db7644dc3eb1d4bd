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
    little = f"by the state equations at most {_percent(state.least_gain)} of the error could still be gained"
    missed = "" if target is None else f"; the target of {target:g} is missed"
    nowhere = f", and no point has {_percent(WANTED)} of it or less" if state.is_too_large else ""
    beyond = f", but they {error}" if error else ""
    reason = f"{little}{nowhere}{missed}{beyond}"
    return Ending(reason, converged=(target is None or state.equations.is_sure) and not error)


def outdone(equations: Equations) -> Ending:
    """Return the end of a search whose equations know the optimum as well as they can."""
    n, error = len(equations.vain), max(equations.vain)
    return Ending(
        f"the last {n} simulations at the optimum of the state equations gained less than the equations "
        f"err by ({_percent(error)} of the error): at most {_percent(PROMISED)} of it could still be gained",
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
    tests = f"{_counted(known.n_tested, 'round')} of checks"
    if known.n_restarts:
        tests += f" and {_counted(known.n_restarts, 'restart')}"
    in_vain = f"{tests} gained less than {_percent(CONFIRMED)} of the error"
    if is_too_large:
        return Ending(f"{in_vain}; it is still more than the sensor's uncertainty explains", converged=False)
    # Four of six thermostats had said "converged" and were wrong (docs/calibration.md).
    if switches:
        return Ending(
            f"{in_vain}; the model switches at times that depend on its parameters, so there may be a lower "
            "minimum in another region",
            converged=False,
        )
    if known.is_promising:
        return Ending(f"{in_vain}, and no more is expected near the best point", converged=False)
    return Ending(
        f"the search expects at most {_percent(PROMISED)} less error anywhere within the bounds; {in_vain}",
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
        return "the first simulations are not finished; a larger --max-calls goes on with them"
    if state.is_too_large and state.is_tried:
        return "there may be a better minimum, or the model misses an effect; try another --seed"
    if not rows.window.is_whole:
        return "so far only the first part of the window is fitted; a larger --max-calls fits the rest"
    if state.is_at_best and not state.region.is_whole:
        return "simulations around the best point fail; a larger --max-calls begins away from it"
    if state.confirmation.n_tested or state.has_settled:
        return still_owed(state.confirmation, state.settings.ftol)
    n = min(STALL_ROUNDS * state.settings.n_parallel, rows.n - 1)
    before = float(rows.objective[: rows.n - n].min())
    gained = 1.0 - rows.lowest() / before if np.isfinite(before) and before > 0.0 else 1.0
    expected = state.expected_gain
    hope = f" (expected of the last round: {_percent(expected)})" if np.isfinite(expected) else ""
    return (
        f"the last {_counted(n, 'simulation')} gained {_percent(gained)} of the error{hope}; a larger "
        "--max-calls goes on from the best point"
    )


def still_owed(known: Confirmation, ftol: float) -> str:
    """Say which checks and restarts are left to a search that expects less than `ftol` and has to stop."""
    if known.is_tested and known.has_looked:
        return (
            f"a gain of up to {_percent(known.promised)} of the error is not excluded beside it within "
            "the bounds; try another --seed"
        )
    owed = known.n_owed
    tests = f"{min(known.n_tested, owed + 1)} of {owed + 1} rounds of checks"
    restarts = f"{min(known.n_restarts, owed)} of {owed} restarts"
    return (
        f"near the best point less than {_percent(ftol)} of the error is left to gain, but the search ended "
        f"during its final checks ({tests} and {restarts} are done); a larger --max-calls finishes them"
    )


def _percent(share: float) -> str:
    return f"{100.0 * share:.2g} %"


def _counted(n: int, noun: str) -> str:
    return f"{n} {noun}" if n == 1 else f"{n} {noun}s"
