"""What an adaptive calibration knows beforehand: stored simulations, and what it says of them."""

from typing import Any

from simulation.errors import InputError
from simulation.store.stored_model import StoredModel
from studies.calibration.adaptive import Adaptive
from studies.calibration.known_rows import missing_of_design
from studies.calibration.problem import CalibrationProblem, Evaluation
from studies.calibration.state_guide import LEAST_CALLS
from studies.partly_fixed import PartlyFixedModel
from studies.report.wording import count
from studies.stages.known_rows import ChooseRows, Known, fitting_theta, judge_known
from studies.stages.pipeline import Study
from studies.watched_model import StoredWatchedModel


def known_of(
    study: Study,
    problem: CalibrationProblem,
    physical: StoredModel,
    model: PartlyFixedModel,
    known_rows: ChooseRows,
) -> tuple[Known, Evaluation]:
    """Return what is known beforehand and how good it is, and say how much that is.

    Args:
        study: the study.
        problem: the problem of the free parameters.
        physical: the model with all its simulations.
        model: the same, asked the free parameters alone.
        known_rows: which rows are known.
    """
    known = known_rows(physical, model, problem, lambda found: -found.objective)
    theta = model.complete(known.theta)
    if not len(theta):
        fixed = (
            " with the fixed parameters at these values"
            if model.parameter_space.n_parameters < physical.parameter_space.n_parameters
            else ""
        )
        study.console.say(
            f"no good simulation of this model within the bounds{fixed} is stored: it begins with none"
        )
    else:
        study.console.say(f"begins with {count(len(theta), 'stored simulation')} of this model")
    return known, judge_known(problem, physical, model, known)


def known_arrays(known: Known | None, *, state_equations: bool) -> dict[str, Any]:
    """Return what a result keeps of rows that were known beforehand; empty where none were asked for."""
    if known is None:
        return {}
    return {"known_theta": known.theta} | ({"known_watched": known.watched} if state_equations else {})


def check_design(settings: Adaptive, known: Evaluation, n_kept: int, *, state_equations: bool) -> None:
    """Refuse a budget that does not hold what known rows leave open of a first design.

    Args:
        settings: how to search.
        known: what is known.
        n_kept: calls of the budget that are for something else.
        state_equations: whether they are learnt, from less than a first design.
    """
    n_parameters = known.u.shape[1]
    n_start = settings.design_size(n_parameters)
    n_missing = missing_of_design(known, n_start)
    if state_equations:
        n_missing = min(n_missing, LEAST_CALLS)
    if settings.max_calls < n_kept + n_missing:
        design = f"{n_missing} of {count(n_start, 'simulation')} of a first design"
        raise InputError(
            f"--max-calls {settings.max_calls} does not hold the {design} that are not stored; give "
            f"{n_kept + n_start + n_missing} or more"
        )


def offer_stored(study: Study, physical: StoredModel, model: PartlyFixedModel) -> None:
    """Say what is stored to somebody who does not begin with it."""
    theta = model.complete(fitting_theta(physical.store, model))
    n_good = int(physical.store.find_good(theta).sum())
    if not n_good:
        return
    stored, read = count(n_good, "stored simulation"), "read where asked for"
    if isinstance(physical, StoredWatchedModel):
        n_watched = int(physical.watched(theta).sum())
        read = f"{n_watched} with their states, {read}" if n_watched < n_good else read
    study.console.say(f"{stored} of this model: {read}; --from-stored begins with the best")
