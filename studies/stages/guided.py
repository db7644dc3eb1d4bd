"""A calibration's guide by state equations: what opens it, and what became of it in numbers and words."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from simulation.case import Case
from simulation.store.stored_model import StoredModel
from studies.calibration.learned_ode import LearnedODE
from studies.calibration.problem import CalibrationProblem
from studies.calibration.states import StateSignals, why_unwatched
from studies.report.wording import count, listed
from studies.watched_model import StoredWatchedModel


def are_state_equations_learnt(case: Case, wish: bool | None) -> bool:
    """Return whether a calibration learns state equations.

    Args:
        case: the case.
        wish: what the user said, None for nothing: then it does where it can.

    Raises:
        InputError: the user wants it, and the FMU does not show its states.
    """
    if wish is None:
        return not why_unwatched(case)
    if wish:
        StateSignals.of(case)
    return wish


def guide_of(physical: StoredModel, problem: CalibrationProblem) -> LearnedODE | None:
    """Return what learns the state equations of a problem, None where the states are not watched."""
    if not isinstance(physical, StoredWatchedModel):
        return None
    return LearnedODE(physical.signals, physical.seen, problem)


def asked_twice(physical: StoredModel) -> int:
    """Return how many rows were asked a second time, because their states could not be read."""
    return physical.n_asked_twice if isinstance(physical, StoredWatchedModel) else 0


def guided_numbers(guide: LearnedODE | None, physical: StoredModel) -> dict[str, Any]:
    """Return what became of state equations; empty where nobody watched the states."""
    if guide is None:
        return {}
    unread = physical.why_unread if isinstance(physical, StoredWatchedModel) else ""
    fails = f"the FMU fails where states are read ({unread}; --retry-failed asks again)"
    why_not = fails if unread else guide.why_not
    return {
        "state_equations": {
            "n_states": guide.n_states,
            "n_calls": guide.n_asked,
            "misfit": guide.misfit if np.isfinite(guide.misfit) else None,
            "hidden_inputs": list(guide.hidden_inputs),
            "error_at_best": guide.error_at_best if guide.is_believed else None,
            "are_believed": guide.is_believed,
            "why_not": None if guide.is_learnt else why_not,
            "without_effect": list(guide.without_effect),
        }
    }


def equations_in_words(found: Mapping[str, Any]) -> str:
    """Say what became of state equations."""
    states, calls = count(found["n_states"], "state"), count(found["n_calls"], "call")
    # Results of version 0.2 name no hidden inputs.
    hidden = found.get("hidden_inputs")
    learnt = f"learnt with {listed(hidden)} of the FMU as {_inputs(len(hidden))}" if hidden else "learnt"
    if found["are_believed"]:
        end = f"{learnt}, and {calls} went where they expect the lowest error"
        if found.get("without_effect"):
            end += f"; {listed(found['without_effect'])} changed nothing in any simulation"
    elif found["why_not"] is None:
        end = f"{learnt}, but their last predictions were wrong, after {calls}; the search went on without"
    else:
        how = f"given up after {calls}" if found["n_calls"] else "not learnt"
        end = f"{how}, for {found['why_not']}; the search did without"
    return f"State equations of {states}: {end}"


def _inputs(n: int) -> str:
    return "input" if n == 1 else "inputs"
