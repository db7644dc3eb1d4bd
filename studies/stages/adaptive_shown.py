"""What the terminal says of an adaptive calibration."""

from simulation.time_unit import period_text
from studies.calibration.doubt import DOUBT
from studies.calibration.recorder import History
from studies.console import format_seconds
from studies.physical_model import warn_failed
from studies.report.wording import count, difference_unit, percent, quantity, squared
from studies.stages.adaptive import adaptive_command
from studies.stages.calibrated_values import show_parameters
from studies.stages.check import found_of_the_step
from studies.stages.guided import equations_in_words
from studies.stages.guideline import Periods, judge_calibration, show_guideline
from studies.stages.knowledge import is_of_this_density, show_prior
from studies.stages.pipeline import Outcome, Study, Summary, read_json
from studies.stages.restriction_shown import show_restriction
from studies.stages.results import (
    ADAPTIVE,
    adaptive_files,
    most_relevant,
    n_free_of,
    read_arrays,
    restricted,
)
from studies.stages.validation import show_validation


def show_adaptive(study: Study, outcome: Outcome) -> None:
    """Print what was found, why it ended and what it cost."""
    found, console = outcome.summary, study.console
    unit = squared(difference_unit(study.case.outputs[0].unit))
    n_calls, n_free = found["ledger"]["total_paper"], n_free_of(found)
    how = ADAPTIVE + restricted(n_free)
    is_parallel = found["settings"]["n_parallel"] > 1
    rounds = "" if not is_parallel else f" in {count(found['n_rounds'], 'round')}"
    n_known = found.get("n_known")
    begun = f", begun with {count(n_known, 'stored simulation')}" if n_known else ""
    cost = f"{count(n_calls, 'model call')}{rounds}{begun}"
    console.result(
        f"{study.label}: MSE {quantity(found['mse'], unit, 4)} after {cost} "
        f"({format_seconds(outcome.wall_s)}); it ended because {found['stop_reason']}"
    )
    if found.get("left"):
        console.result(f"Stopped, not converged: {found['left']}")
    warn_failed(study, found)
    if "state_equations" in found:
        console.result(equations_in_words(found["state_equations"]))
    console.result(_fit(study, found))
    doubtful = found["settings"]["doubtful_mse"]
    if doubtful is not None and found["mse"] > doubtful:
        of_the_step = found_of_the_step(study)
        if of_the_step is None and study.case.scenario.inputs_at_edges is not None:
            of_the_step = ""  # outputs see their inputs in time
        doubt = _doubt(found, of_the_step)
        console.result(f"That is more than {DOUBT:g} times the sensor's uncertainty: {doubt}")
    for known in study.case.references:
        if known.is_target:
            reached = calls_to(study, known.mse, n_free)
            calls = "not reached" if reached is None else f"reached after {count(reached, 'call')}"
            console.result(f"MSE {quantity(known.mse, unit)} ({known.label}): {calls}")
    show_parameters(study, found, how)
    show_prior(study, found, how)
    show_restriction(study, found, how)
    show_validation(study, [outcome])
    show_guideline(study, judged_adaptive(study, outcome))
    if study.case.note:
        console.result(f"Note: {study.case.note}")
    console.result(f"Pictures: studies report {study.command}")
    console.result(f"How sure it is: studies uncertainty {study.command}{most_relevant(n_free)}")


def _doubt(found: Summary, of_the_step: str | None) -> str:
    """Say what an error that is too large may come from.

    Args:
        found: A calibration's numbers.
        of_the_step: What studies check found wrong with the communication step, "" where nothing can be, see
            `found_of_the_step`.
    """
    lacks = "the model lacks something"
    if of_the_step:
        lacks = f"studies check found that {of_the_step}; else {lacks}"
    elif of_the_step is None:
        lacks += ", or outputs lag behind inputs by a part of the communication step (studies check tells)"
    target = found["settings"]["target_mse"]
    if target is not None and found["mse"] <= target:
        return "the search ended at its target; without --target it goes on"
    if found["converged"]:
        is_guided = found.get("state_equations", {}).get("are_believed", False)
        who = "state equations know of" if is_guided else "surrogate expects"
        return f"the {who} no deeper valley in the box: {lacks}, or a bound is in the way"
    is_spent = found["ledger"]["total_paper"] >= found["settings"]["max_calls"]
    more = "more --max-calls, " if is_spent else ""
    try_ = f"try {more}another --seed, or studies run"
    return f"there may be a deeper valley, or {lacks}; {try_}"


def stored_before(study: Study, n_free: int | None) -> Summary | None:
    """Return the numbers of the calibration that is stored, None where none is, or of another question."""
    numbers = read_json(adaptive_files(study, n_free).numbers)
    manifest = read_json(study.results / f"calibrate-{ADAPTIVE}{restricted(n_free)}.json")
    is_same = manifest is not None and is_of_this_density(manifest["inputs"], study.case)
    return numbers if is_same else None


def show_replaced(study: Study, before: Summary | None, outcome: Outcome) -> None:
    """Say that a worse calibration replaced a better one.

    Args:
        study: the study.
        before: what `stored_before` returned before it.
        outcome: this one.
    """
    found = outcome.summary
    same = ("case_sha256", "measurement_sha256")
    if before is None or outcome.reused or any(before.get(name) != found[name] for name in same):
        return
    if not before["mse"] < found["mse"]:
        return
    unit = squared(difference_unit(study.case.outputs[0].unit))
    study.console.warn(
        f"this replaces a better stored result, MSE {quantity(before['mse'], unit, 4)} after "
        f"{count(before['ledger']['total_paper'], 'model call')}; to have it back from the stored "
        f"simulations, type: {adaptive_command(study, before)}"
    )


def judged_adaptive(study: Study, outcome: Outcome) -> Periods:
    """Judge the calibration by ASHRAE guideline 14."""
    y = read_arrays(adaptive_files(study, n_free_of(outcome.summary)).arrays)["y"]
    return judge_calibration(study.case, y, outcome.summary)


def calls_to(study: Study, target: float, n_free: int | None = None) -> int | None:
    """Return the calls after which the error was at most the target. [first output's unit squared]."""
    arrays = read_arrays(adaptive_files(study, n_free).arrays)
    return History(arrays["history_calls"], arrays["history_mse"]).calls_to(target)


def _fit(study: Study, found: Summary) -> str:
    parts = []
    for output in study.case.outputs:
        fit, unit = found["outputs"][output.name], difference_unit(output.unit)
        part = f"{output.name} differs by {quantity(fit['rmse'], unit)} (RMS)"
        if fit["uncertainty"] is not None:
            sensor = f"±{fit['uncertainty']:g} {unit}".strip()
            part += f", {percent(fit['share_within'])} of it within the sensor's {sensor}"
        parts.append(part)
    return f"On {period_text(study.case.window_d)} {'; '.join(parts)}"
