"""The state equations of a stage: where they can be learnt, who learns them, and what became of them."""

import numpy as np

from simulation.case import Case
from simulation.store.stored_model import StoredModel
from studies.calibration.experiments_ode import learned_ode
from studies.calibration.learned_ode import LearnedODE
from studies.calibration.problem import CalibrationProblem
from studies.calibration.states import StateSignals, why_unwatched
from studies.stages.stage_results import EquationsFound
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
    for one in case.experiments or (case,):
        if wish:
            StateSignals.of(one)
    return wish


def learned_ode_of(case: Case, physical: StoredModel, problem: CalibrationProblem) -> LearnedODE | None:
    """Return what learns the state equations of a problem, None where the states are not watched."""
    if not isinstance(physical, StoredWatchedModel):
        return None
    return learned_ode(case, physical.watching, problem)


def asked_twice(physical: StoredModel) -> int:
    """Return how many rows were asked a second time, because their states could not be read."""
    return physical.n_asked_twice if isinstance(physical, StoredWatchedModel) else 0


def equations_found(ode: LearnedODE | None, physical: StoredModel) -> EquationsFound | None:
    """Return what became of state equations; None where the states were not watched."""
    if ode is None:
        return None
    unread = physical.why_unread if isinstance(physical, StoredWatchedModel) else ""
    fails = f"the FMU fails where states are read ({unread}; --retry-failed asks again)"
    return EquationsFound(
        n_states=ode.n_states,
        n_calls=ode.n_asked,
        misfit=ode.misfit if np.isfinite(ode.misfit) else None,
        hidden_inputs=tuple(ode.hidden_inputs),
        error_at_best=ode.error_at_best if ode.is_believed else None,
        are_believed=ode.is_believed,
        why_not=None if ode.is_learnt else fails if unread else ode.why_not,
        without_effect=tuple(ode.without_effect),
    )
