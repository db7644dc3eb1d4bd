"""What the terminal shows of calibrations and their uncertainty: tables and sentences of the page."""

import math
from collections.abc import Iterator, Sequence

from studies.calibration.search.misfit_threshold import SENSOR_UNCERTAINTIES
from studies.reporting.sentences import (
    calibration_sentences,
    choice_sentences,
    headline,
    planned_sentences,
    profile_sentences,
    uncertainty_sentences,
)
from studies.reporting.tables import (
    best_of,
    calibrations_table,
    intervals_table,
    parameters_table,
    planned_table,
    profiles_table,
    structures_table,
    validation_table,
)
from studies.results.choice import Choice
from studies.results.outcome import Outcome
from studies.results.planned import Planned
from studies.results.profiled import Profiles
from studies.results.stage_results import Calibration, Uncertainty
from studies.stages.check_stage import found_of_the_step
from studies.task import Task
from studies.words.wording import count, difference_unit, quantity, square_of


def show_calibrations(task: Task, outcomes: Sequence[Outcome[Calibration]]) -> None:
    """Print a row per training-set size, as the paper's Table 4, and what the least error means."""
    case, console = task.case, task.console
    best = best_of(tuple(outcomes))
    assert best is not None, "at least one"
    found = best.result
    if not found.is_adaptive:
        console.show([calibrations_table(case, tuple(outcomes))])
    which = "" if found.is_adaptive else f", {found.shown_name}"
    console.result(f"{task.label}{which}: {headline(case, best)}")
    for one in outcomes:
        _warn_failed(task, one.result)
    if found.left:
        console.result(f"Not converged: {found.left}")
    for line in calibration_sentences(case, found):
        console.result(line)
    if found.is_adaptive:
        _show_search(task, found)
    for one in outcomes:
        if (table := validation_table(case, one.result)) is not None:
            console.show([table])
    if math.isfinite(found.mse):
        console.show([parameters_table(case, found)])
    if case.note:
        console.result(f"Note: {case.note}")
    steps = "\n".join(f"  {n}. {step}" for n, step in enumerate(_next_steps(task, found), start=1))
    console.result(f"next:\n{steps}")


def _next_steps(task: Task, found: Calibration) -> Iterator[str]:
    """Say what to do after a calibration."""
    judged, most = found.determined_by_data, found.settings.get("max_calls")
    if not found.converged and isinstance(most, int) and found.n_calls_paper >= most:
        yield f"go on with the search: studies calibrate {task.command} --max-calls {2 * most}"
    if judged is not None and judged.open:
        what = f": studies next {task.command}" if found.is_adaptive else ""
        yield f"not all parameters are determined: fix some under [fixed], give priors, or measure more{what}"
    which = "" if found.is_adaptive else f" --n-train {found.n_train}"
    yield f"intervals of the parameters: studies uncertainty {task.command}{which}"
    if found.is_adaptive:
        yield f"pictures: studies report {task.command}"
    if math.isfinite(found.mse):
        yield f"values for other programs: studies best {task.label} --write ssv"


def _show_search(task: Task, found: Calibration) -> None:
    """Say whether an adaptive calibration is an answer, and when it reached what is known."""
    threshold, unit = found.settings["misfit_threshold"], square_of(task.case.outputs[0].unit)
    if isinstance(threshold, float) and found.mse > threshold:
        many = f"{SENSOR_UNCERTAINTIES:g} times the sensor's uncertainty"
        task.console.result(f"That is more than {many}: {_misfit(task, found)}")
    for known in task.case.references:
        if known.is_target:
            reached = found.history.calls_to(known.mse)
            calls = "not reached" if reached is None else f"reached after {count(reached, 'call')}"
            task.console.result(f"{found.error_name} {quantity(known.mse, unit)} ({known.label}): {calls}")


def _misfit(task: Task, found: Calibration) -> str:
    """Say what an error that is too large may come from."""
    of_the_step, lacks = found_of_the_step(task), "the model misses an effect"
    if any(one.loss for one in task.case.outputs):
        lacks = f"outliers weigh so much, or {lacks}"
    if of_the_step:
        lacks = f"studies check found that {of_the_step}; else {lacks}"
    elif of_the_step is None and task.case.scenario.inputs_at_edges is None:
        # With inputs at the edges outputs see them in time.
        lacks += ", or outputs lag behind inputs by a part of the communication step (studies check tests it)"
    target, most = found.settings["target_mse"], found.settings["max_calls"]
    if isinstance(target, float) and found.mse <= target:
        return "the search ended at its target; without --target it goes on"
    if found.converged:
        who = "state equations know of" if found.believes_equations else "surrogate expects"
        return f"the {who} no better minimum within the bounds: {lacks}, or a bound is in the way"
    more = "more --max-calls, " if isinstance(most, int) and found.n_calls_paper >= most else ""
    return f"there may be a better minimum, or {lacks}; try {more}another --seed, or studies run"


def show_uncertainty(task: Task, found: Uncertainty) -> None:
    """Print intervals, and what the data determine and what not."""
    case = task.case
    task.console.show([intervals_table(case.parameter_space, found)])
    _warn_failed(task, found)
    for sentence in uncertainty_sentences(found, difference_unit(case.outputs[0].unit)):
        task.console.result(sentence)
    if case.note:
        task.console.result(f"Note: {case.note}")
    task.console.result(f"Pictures: studies report {task.command}")


def show_profiles(task: Task, found: Profiles, posterior: Uncertainty) -> None:
    """Print the intervals of profiles beside the posterior's, and where they are open."""
    task.console.show([profiles_table(task.case.parameter_space, found, posterior)])
    for sentence in profile_sentences(found):
        task.console.result(sentence)


def show_planned(task: Task, found: Planned) -> None:
    """Print candidates for the next experiment, and where the tables of the best one lie."""
    task.console.show([planned_table(found)])
    for sentence in planned_sentences(found):
        task.console.result(sentence)
    for what, place in (("For the case file", found.block), ("Its inputs", found.inputs)):
        if place:
            task.console.result(f"{what}: {task.paths.show(task.paths.root / place)}")


def show_choice(task: Task, found: Choice) -> None:
    """Print what speaks for each structure, and which one the data choose."""
    unit = difference_unit(task.case.outputs[0].unit)
    task.console.show([structures_table(found, unit)])
    for sentence in choice_sentences(found, unit):
        task.console.result(sentence)


def _warn_failed(task: Task, found: Calibration | Uncertainty) -> None:
    if found.n_failed:
        task.console.warn(
            f"{count(found.n_failed, 'simulation')} failed, the first one: {found.first_failure} "
            "(--retry-failed asks again)"
        )
